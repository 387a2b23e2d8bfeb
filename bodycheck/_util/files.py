"""Files that survive crashes: written whole or not at all, checked by a digest when read."""

from __future__ import annotations

import json
import os
import secrets
import tempfile
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from bodycheck._util.errors import InputError

_LONGEST_STEM = 50  # file names are limited to 255 bytes


def check_file(option: str, path: Path | None) -> None:
    """Raise InputError if the file that an option names cannot be written; accept None.

    Call it before a long computation, so that no result is lost for lack of a folder.
    """
    if path is None:
        return
    folder = path.absolute().parent
    if os.path.isdir(path):  # noqa: PTH112 - accepts names of any length
        raise InputError(f"{option} {path}: is a folder; name a file")
    if not os.path.isdir(folder):  # noqa: PTH112
        raise InputError(f"{option} {path}: cannot be written: there is no folder {folder}")
    check_folder(f"{option} {path}", folder)


def check_folder(prefix: str, folder: Path) -> None:
    """Raise InputError, with this prefix, if no file can be created in a folder.

    If the folder does not exist, test its nearest existing parent.
    """
    try:
        place = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise InputError(f"{prefix}: cannot be written: {error.strerror or error}") from None


def write_file(path: Path, content: bytes) -> None:
    """Write a file atomically; raises InputError if it cannot be written."""
    try:
        atomic_write(path, content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def atomic_write(path: Path, content: bytes) -> None:
    """Write a file under a temporary name in its folder and rename it; raises OSError."""
    unfinished = unfinished_name(path.absolute())
    try:
        with unfinished.open("xb") as file:  # not mkstemp, which ignores the umask
            file.write(content)
        unfinished.replace(path)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink()
        raise


def unfinished_name(path: Path) -> Path:
    """Return a unique temporary name in the folder of a file or folder that is being written."""
    return path.with_name(f".{path.name[:_LONGEST_STEM]}-{secrets.token_hex(8)}")


def sealed(message: dict[str, Any]) -> bytes:
    """Return a message as one line with its checksum, newline included."""
    text = json.dumps(message, separators=(",", ":")).encode()
    return sha256(text).hexdigest().encode() + b" " + text + b"\n"


def opened(line: bytes) -> dict[str, Any] | None:
    """Return the message of a line; None if the line is truncated or altered."""
    digest, _, text = line.removesuffix(b"\n").partition(b" ")
    if not line.endswith(b"\n") or sha256(text).hexdigest().encode() != digest:
        return None
    message: dict[str, Any] = json.loads(text)
    return message
