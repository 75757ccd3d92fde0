"""Files and folders of keys: created with their final modes, never overwritten."""

from __future__ import annotations

import os
from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from llm_flock.errors import InputError

PRIVATE = 0o600
PRIVATE_FOLDER = 0o700
PUBLIC = 0o644


def check_private(path: Path) -> None:
    if os.name == "posix" and path.stat().st_mode & 0o077:  # on Windows the mode says nothing about access
        raise InputError("keys", str(path), "a file that only its owner may read: chmod 600")


def make_folder(path: Path) -> Path:
    try:
        path.mkdir(mode=PRIVATE_FOLDER, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("folder", str(path), f"a folder that can be made ({error.strerror})") from None
    return path


def write_new(path: Path, content: bytes, mode: int) -> None:
    """Create a file with its final mode: other users can at no moment open a secret."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)


def pem(key: Ed25519PrivateKey | ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
