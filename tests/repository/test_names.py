"""Every name is defined. Ruff and mypy are told not to look, because they take jaxtyping's shapes for names."""

import ast
from pathlib import Path

import jaxtyping
import pytest
from pyflakes.checker import Checker
from pyflakes.messages import UndefinedName

ROOT = Path(__file__).parents[2]


class WithoutShapes(ast.NodeTransformer):
    """Replaces `Float[np.ndarray, "world 2"]` by `Float`, wherever it stands."""

    def visit_Subscript(self, node):
        self.generic_visit(node)
        return node.value if isinstance(node.value, ast.Name) and hasattr(jaxtyping, node.value.id) else node


def undefined(text, file="text.py"):
    tree = ast.fix_missing_locations(WithoutShapes().visit(ast.parse(text)))
    found = Checker(tree, file).messages
    return [f"{file}:{one.lineno}: {one.message_args[0]}" for one in found if isinstance(one, UndefinedName)]


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["crowdbench", "adapters", "agents", "benchmarks", "examples", "tests"])
def test_every_name_is_defined(folder):
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    assert [one for file in files for one in undefined(file.read_text(), str(file.relative_to(ROOT)))] == []


def test_a_name_that_is_not_would_be_seen():
    shape = 'from jaxtyping import Float\nimport numpy as np\ndef f(x: Float[np.ndarray, "world 2"]): return '
    assert undefined(shape + "x") == []
    assert undefined(shape + "load(x)") == ["text.py:3: load"]
