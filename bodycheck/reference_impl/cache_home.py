"""Where bodycheck keeps what it need not compute again: compiled kernels, truths, answers of engines."""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path

_FOR_NOW = "BODYCHECK_KERNELS_FOR_NOW"
"""Tells the processes that this one starts of the folder that it made in place of the user's."""


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
    change in any file of this room starts an empty folder. ``BODYCHECK_CACHE_DIR`` moves it. Where it cannot
    be written a temporary one takes its place, which ends with this process, and a line says so: numba by
    itself would write beside the sources, where nothing knows of changed callees, or give up.
    """
    if for_now := os.environ.get(_FOR_NOW):
        return Path(for_now)
    kept = cache_home() / "kernels" / digest_of(Path(__file__).parent)[:16]
    try:
        kept.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=kept):
            return kept
    except OSError as error:
        why = f"{cache_home()}: cannot be written: {error.strerror or error}"
    made = tempfile.mkdtemp(prefix="bodycheck-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    os.environ[_FOR_NOW] = made
    print(f"{why}; what is compiled is kept for this command alone", file=sys.stderr)
    return Path(made)


def digest_of(folder: Path) -> str:
    """Return a hash of all the Python sources in and below a folder, and of their places in it."""
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        digest.update(source.relative_to(folder).as_posix().encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()
