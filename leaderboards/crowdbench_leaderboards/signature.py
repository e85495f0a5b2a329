"""Signatures of maintainers, made and checked by `ssh-keygen -Y` of OpenSSH, which keeps the keys.

leaderboards/maintainers     a line for each maintainer: name namespaces="crowdbench" ssh-ed25519 AAAA...
FILE.sig                     the signature of a file

Private keys are in no repository.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from crowdbench import InputError

MAINTAINERS_FILE = "maintainers"
SIGNATURE = ".sig"

_NAMESPACE = "crowdbench"
"""The purpose of a signature: signatures for other purposes do not count."""


def sign(path: Path, key: Path) -> None:
    """Write the signature of a file beside it.

    Args:
        path: The file.
        key: A private key of OpenSSH, or a public key whose private key is in an SSH agent.

    Raises:
        InputError: The key is missing or cannot sign.
    """
    if not key.is_file():
        raise InputError(f"there is no key {key}: give a private key of OpenSSH, such as one that ssh-keygen makes")
    path.with_name(path.name + SIGNATURE).unlink(missing_ok=True)  # otherwise ssh-keygen prompts before replacing it
    done = _run_ssh_keygen("sign", ["-f", str(key), str(path)])
    if done.returncode != 0:
        raise InputError(f"the key {key} does not sign: {_last_line(done)}")


def find_signer(key: Path, root: Path) -> str:
    """Return the name of the maintainer who owns a key.

    Args:
        key: As for `sign`.
        root: The folder of boards, which has the file `maintainers`.

    Raises:
        InputError: The key is no maintainer's, or cannot sign.
    """
    maintainers = root / MAINTAINERS_FILE
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "trial"
        trial.write_bytes(b"")
        sign(trial, key)
        names = ["-f", str(maintainers), "-s", str(trial.with_name(trial.name + SIGNATURE))]
        owners = _run_ssh_keygen("find-principals", names).stdout.decode(errors="replace").splitlines()
        if not owners or not is_signed(trial, owners[0], root):
            raise InputError(
                f"the key {key} is no maintainer's: {maintainers} has no line for it, such as "
                f'name namespaces="{_NAMESPACE}" ssh-ed25519 AAAA...'
            )
    return owners[0]


def is_signed(path: Path, name: str, root: Path) -> bool:
    """Check if the maintainer of this name has signed the present contents of a file.

    Args:
        path: The file.
        name: The name of the maintainer.
        root: The folder of boards.
    """
    signature = path.with_name(path.name + SIGNATURE)
    if not signature.is_file():
        return False
    names = ["-f", str(root / MAINTAINERS_FILE), "-I", name, "-s", str(signature)]
    return _run_ssh_keygen("verify", names, path.read_bytes()).returncode == 0


def _run_ssh_keygen(action: str, arguments: list[str], content: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    command = ["ssh-keygen", "-Y", action]
    if action != "find-principals":
        command += ["-n", _NAMESPACE]
    try:
        return subprocess.run([*command, *arguments], input=content, capture_output=True)
    except FileNotFoundError:
        raise InputError("signatures are made and checked by ssh-keygen, which is missing: install OpenSSH") from None


def _last_line(done: subprocess.CompletedProcess[bytes]) -> str:
    return (done.stderr.decode(errors="replace").strip().splitlines() or ["no error message"])[-1]
