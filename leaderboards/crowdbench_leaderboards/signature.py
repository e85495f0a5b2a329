"""Signatures of maintainers, made and checked by `ssh-keygen -Y` of OpenSSH, which keeps the keys.

leaderboards/maintainers     a line for each maintainer: name namespaces="crowdbench" ssh-ed25519 AAAA...

Private keys are in no repository.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

from crowdbench import InputError

MAINTAINERS_FILE = "maintainers"

_NAMESPACE = "crowdbench"
"""The purpose of a signature: signatures for other purposes do not count."""

_BEGIN, _END = "-----BEGIN SSH SIGNATURE-----", "-----END SSH SIGNATURE-----"


def sign(content: bytes, key: Path) -> str:
    """Return the signature of a content, in base64 without line breaks.

    Args:
        content: The content.
        key: A private key of OpenSSH, or a public key whose private key is in an SSH agent.

    Raises:
        InputError: The key is missing or cannot sign.
    """
    if not key.is_file():
        raise InputError(f"there is no key {key}: give a private key of OpenSSH, such as one that ssh-keygen makes")
    done = _run_ssh_keygen("sign", ["-n", _NAMESPACE, "-f", str(key)], content)
    if done.returncode != 0:
        raise InputError(f"the key {key} does not sign: {_last_line(done)}")
    return "".join(line for line in done.stdout.decode().splitlines() if not line.startswith("-----"))


def find_signer(key: Path, root: Path) -> str:
    """Return the name of the maintainer who owns a key.

    Args:
        key: As for `sign`.
        root: The folder of boards, which has the file `maintainers`.

    Raises:
        InputError: The key is no maintainer's, or cannot sign.
    """
    maintainers = root / MAINTAINERS_FILE
    signature = sign(b"", key)
    owners = _check(["find-principals", "-f", str(maintainers)], b"", signature).stdout.decode(errors="replace")
    for owner in owners.splitlines():
        if is_signed(b"", signature, owner, root):
            return owner
    raise InputError(
        f"the key {key} is no maintainer's: {maintainers} has no line for it, such as "
        f'name namespaces="{_NAMESPACE}" ssh-ed25519 AAAA...'
    )


def is_signed(content: bytes, signature: str, name: str, root: Path) -> bool:
    """Check if the maintainer of this name has signed a content.

    Args:
        content: The content.
        signature: The signature, see `sign`.
        name: The name of the maintainer.
        root: The folder of boards.
    """
    names = ["verify", "-n", _NAMESPACE, "-f", str(root / MAINTAINERS_FILE), "-I", name]
    return bool(re.fullmatch("[A-Za-z0-9+/=]+", signature)) and _check(names, content, signature).returncode == 0


def _check(arguments: list[str], content: bytes, signature: str) -> subprocess.CompletedProcess[bytes]:
    with tempfile.NamedTemporaryFile("w", suffix=".sig") as file:
        lines = [signature[start : start + 70] for start in range(0, len(signature), 70)]
        file.write("\n".join([_BEGIN, *lines, _END, ""]))
        file.flush()
        action, *others = arguments
        return _run_ssh_keygen(action, [*others, "-s", file.name], content)


def _run_ssh_keygen(action: str, arguments: list[str], content: bytes) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(["ssh-keygen", "-Y", action, *arguments], input=content, capture_output=True)
    except FileNotFoundError:
        raise InputError("signatures are made and checked by ssh-keygen, which is missing: install OpenSSH") from None


def _last_line(done: subprocess.CompletedProcess[bytes]) -> str:
    return (done.stderr.decode(errors="replace").strip().splitlines() or ["no error message"])[-1]
