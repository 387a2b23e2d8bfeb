"""A file that is written whole or not at all."""

from __future__ import annotations

import os
import secrets
import tempfile
from contextlib import suppress
from pathlib import Path

from bodycheck._util.errors import InputError

_LONGEST_STEM = 50  # a name may have 255 bytes


def check_file(option: str, path: Path | None) -> None:
    """Raise InputError where the file that an option names could not be written; None: it names none.

    Asked before anything long is run: what was measured must not be lost for want of a folder.
    """
    if path is None:
        return
    folder = path.absolute().parent
    if os.path.isdir(path):  # noqa: PTH112 - no name is too long for it
        raise InputError(f"{option} {path}: is a folder; name a file")
    if not os.path.isdir(folder):  # noqa: PTH112
        raise InputError(f"{option} {path}: cannot be written: there is no folder {folder}")
    check_folder(f"{option} {path}", folder)


def check_folder(asked: str, folder: Path) -> None:
    """Raise InputError, which begins with what was asked, where no file could be made in a folder.

    Of a folder that is still to be made, the nearest that is there is tried.
    """
    try:
        place = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise InputError(f"{asked}: cannot be written: {error.strerror or error}") from None


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole; raises InputError where it cannot be written."""
    try:
        atomic_write(path, content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def atomic_write(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, beside it, and rename it; raises OSError."""
    unfinished = unfinished_name(path.absolute())
    try:
        with unfinished.open("xb") as file:  # not mkstemp: the umask says who may read it
            file.write(content)
        unfinished.replace(path)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink()
        raise


def unfinished_name(path: Path) -> Path:
    """Return a name beside a file or a folder that nothing else has, for the time until it is whole."""
    return path.with_name(f".{path.name[:_LONGEST_STEM]}-{secrets.token_hex(8)}")
