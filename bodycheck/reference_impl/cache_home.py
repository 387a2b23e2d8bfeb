"""Where bodycheck keeps what it need not compute again: compiled kernels, truths, answers of engines."""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path


def cache_home() -> Path:
    """Return the folder; ``BODYCHECK_CACHE_DIR`` names another than the user's cache folder."""
    named = os.environ.get("BODYCHECK_CACHE_DIR")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "bodycheck")


@cache
def cache_directory() -> Path:
    """Return the folder of compiled kernels, named by a hash of all the sources of reference_impl.

    numba's own cache keeps using an old callee when only the callee's file has changed, so a
    change in any file of this room starts an empty folder. ``BODYCHECK_CACHE_DIR`` moves it.
    """
    return cache_home() / "kernels" / digest_of(Path(__file__).parent)[:16]


def digest_of(folder: Path) -> str:
    """Return a hash of all the Python sources in and below a folder, and of their places in it."""
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        digest.update(source.relative_to(folder).as_posix().encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()
