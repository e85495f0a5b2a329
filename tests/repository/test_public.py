import subprocess
import sys


def test_the_public_functions_can_be_called_whatever_was_imported_before():
    code = (
        "import crowdbench.cli, crowdbench.runs.run, crowdbench.check\n"
        "from crowdbench import flatten, load_planner, load_scenario, parallel_env, rollout\n"
        "print(all(map(callable, (flatten, load_planner, load_scenario, parallel_env, rollout))))"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "True\n"
