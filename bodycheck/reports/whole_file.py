"""A file that is written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from bodycheck.errors import InputError


def check_file(option: str, path: Path | None) -> None:
    """Raise InputError where the file that an option names could not be written; None: it names none.

    Asked before anything long is run: what was measured must not be lost for want of a folder.
    """
    if path is None:
        return
    folder = path.absolute().parent
    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; name a file")
    if not folder.is_dir():
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
        put_whole(path, content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def put_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, beside it, and rename it; raises OSError."""
    descriptor, unfinished = tempfile.mkstemp(dir=path.absolute().parent, prefix=f".{path.name}-")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
        Path(unfinished).chmod(0o644)  # mkstemp keeps others out; what is handed over is for everyone
        Path(unfinished).replace(path)
    except BaseException:
        with suppress(OSError):
            Path(unfinished).unlink()
        raise
