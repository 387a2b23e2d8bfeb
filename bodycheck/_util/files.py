"""Atomic writing of files, and checks that a file can be written."""

from __future__ import annotations

import os
import secrets
import tempfile
from contextlib import suppress
from pathlib import Path

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
