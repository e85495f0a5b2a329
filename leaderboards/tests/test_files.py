"""Files of entries that nobody can read, and networks that are equal, are refused."""

import io
import marshal
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from board_entries import PLANNER, entered, submitted
from small_boards import verify

from crowdbench.isolation import sandbox
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.planner_files import check_files
from crowdbench_leaderboards.submission import rehearse
from crowdbench_leaderboards.verdict import Verdict

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]


# A8: compiled files, links, archives, large files


def zipped(*names):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in names:
            archive.writestr(name, b"1")
    return buffer.getvalue()


def tarred():
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("a"))
    return buffer.getvalue()


def bytecode():
    import importlib.util

    return importlib.util.MAGIC_NUMBER + bytes(12) + marshal.dumps(compile("1", "a", "exec"))


def with_objects():
    buffer = io.BytesIO()
    np.savez(buffer, a=np.array([{}, "text"], dtype=object))
    return buffer.getvalue()


REFUSED = {
    "__pycache__/careful.cpython-311.pyc": bytecode(),
    "__pycache__/note.txt": b"text",
    "helper.pyc": bytecode(),
    "helper.PYC": b"anything",
    "weights.bin": bytecode(),
    "old.bin": (3394).to_bytes(2, "little") + b"\r\n" + bytes(20),
    "helper.so": b"anything",
    "helper.cpython-311-x86_64-linux-gnu.so": b"anything",
    "elf": b"\x7fELF" + bytes(99),
    "a.zip": zipped("a.npy"),
    "a.whl": zipped("a.py"),
    "weights.npz": zipped("a.npy", "b.py"),
    "more.npz": zipped("a.npz"),
    "weights.pt": zipped("w/data.pkl", "w/code.py"),
    "hidden.bin": b"#" * 999 + zipped("a.pyc"),
    "a.tar": tarred(),
    "a.txt": tarred(),
    "a.gz": b"\x1f\x8b\x08" + bytes(20),
    "a.xz": b"\xfd7zXZ\0" + bytes(20),
    "weights.npy": b"\x93NUMPY",
    "pickled.pt": zipped("w/data.pkl"),
    "program": b"\xcf\xfa\xed\xfe" + bytes(99),
    "helper.exe": b"MZ" + bytes(99),
    "helper.wasm": b"\0asm\1\0\0\0",
    "program_of_windows": b"MZ\x90\0",
    "notes.lz4": b"\x04\x22\x4d\x18",
    "notes.txt": b"\x04\x22\x4d\x18",
    "objects.npz": with_objects(),
    "code.safetensors": b"\x7fELF" + bytes(99),
    "code.onnx": b"MZ" + bytes(99),
    "joined.onnx": b"\x08\x08\x12" + bytes(99) + zipped("a.py"),
    "bytes.json": b"\xff\xfe{}",
    "control.md": b"a\x1b[2J",
}


@pytest.mark.parametrize("name", REFUSED)
def test_files_that_nobody_can_read_are_refused(name, folder):
    path = folder / "planner" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(REFUSED[name])
    with pytest.raises(InputError, match=r"; allowed are .csv, .json, .md, .npz, .onnx, .py, .safetensors, "):
        read_entry(folder)


@pytest.mark.parametrize("name", ["planner/\u0430.py", "planner/::error::.py", "planner/a\nb.py", "planner/.hidden"])
def test_names_of_files_are_plain(name, folder):
    (folder / name).write_text("")
    with pytest.raises(InputError, match=r"is none of the files that an entry may have|; allowed are"):
        read_entry(folder)


def test_texts_arrays_and_programs_are_files_of_an_entry(tmp_path):
    folder = tmp_path / "planner"
    folder.mkdir()
    np.savez_compressed(folder / "weights.npz", a=np.ones(9))
    safetensors.numpy.save_file({"a": np.ones(9)}, folder / "weights.safetensors")
    (folder / "table.csv").write_bytes(b"ab\r\n1,2\r\n")
    (folder / "program").write_text("#!/usr/bin/env python\n")
    (folder / "readme.md").write_text("Łukasz\n")
    check_files(tmp_path)


@pytest.mark.parametrize("name", ["helper.pyc", "helper.so", "link.py", "control.py"])
def test_submit_refuses_the_same_files(name, tmp_path):
    (tmp_path / "other.py").write_text("")
    path = tmp_path / name
    if name == "link.py":
        path.symlink_to("other.py")
    else:
        path.write_bytes(REFUSED.get(name, b"#\x1b"))
    wanted = entered(tmp_path, f"import {path.stem}\n{PLANNER}")
    with pytest.raises(InputError, match=r"; allowed are|is a link: |No module named 'helper'"):
        rehearse(wanted, tmp_path / "boards")


def test_bytecode_beside_a_planner_is_never_run(tmp_path):
    import importlib.util
    import py_compile

    from crowdbench.plugins.kind import load_module

    for name in ("shown", "helper"):
        path = tmp_path / f"{name}.py"
        path.write_text("value = 'hidden'\n")
        py_compile.compile(str(path), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
        assert Path(importlib.util.cache_from_source(str(path))).exists()
        path.write_text("value = 'shown'\n" + ("import helper\n" if name == "shown" else ""))
    module = load_module(tmp_path / "shown.py")
    assert (module.value, module.helper.value) == ("shown", "shown")


# A9: five equal networks


def weights(path, seed, **metadata):
    values = np.random.default_rng(seed).normal(size=9)
    safetensors.numpy.save_file({"b": values, "a": values[:4]}, path, metadata=metadata or None)
    return str(path)


@pytest.mark.parametrize("metadata", [{}, {"note": "other"}])
def test_networks_with_equal_tensors_are_refused(metadata, tmp_path):
    own = weights(tmp_path / "0.safetensors", 0)
    others = [{"weights": weights(tmp_path / f"{number}.safetensors", 0, **metadata)} for number in range(1, 5)]
    with pytest.raises(InputError, match="two networks of the entry are the same"):
        rehearse(entered(tmp_path, PLANNER, options={"weights": own}, networks=others), tmp_path / "boards")


def test_networks_that_drive_alike_are_refused(tmp_path):
    own = weights(tmp_path / "0.safetensors", 0)
    others = [{"weights": weights(tmp_path / f"{seed}.safetensors", seed)} for seed in range(1, 5)]
    entry, board = submitted(tmp_path, PLANNER, options={"weights": own}, networks=others)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.REFUSED
    assert found.reason == "networks 1 and 2 of its method drive 10 of 10 cases alike"
