"""Where bodycheck keeps what it need not compute again: compiled kernels, truths, answers of engines."""

from __future__ import annotations

import atexit
import errno
import hashlib
import os
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path

_NAMED = "BODYCHECK_CACHE_DIR"
_PROBE = bytes(1 << 16)  # a full disk takes the name of a file, and nothing in it
_FOR_NOW = "BODYCHECK_KERNELS_FOR_NOW"
"""Tells the processes that this one starts of the folder that it made in place of the user's."""


def cache_home() -> Path:
    """Return the folder; ``BODYCHECK_CACHE_DIR`` names another than the user's cache folder."""
    named = os.environ.get(_NAMED)
    if named:
        return Path(named)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "bodycheck")
    except RuntimeError:  # neither HOME nor an entry among the users
        return _for_this_command("there is no home folder: set HOME or BODYCHECK_CACHE_DIR", _NAMED)


@cache
def cache_directory() -> Path:
    """Return the folder of compiled kernels, named by a hash of reference_impl's sources and the compiler.

    numba's own cache keeps using an old callee when only the callee's file has changed, so a change in any
    file of this room starts an empty folder. It knows numba's version and the processor, but not a patched
    numba, another llvmlite, or another NUMBA_OPT: these start an empty folder too. ``BODYCHECK_CACHE_DIR``
    moves it. Where it cannot be written a temporary one takes its place, which ends with this process, and a
    line says so: numba by itself would write beside the sources, where nothing knows of changed callees, or
    give up.
    """
    if for_now := os.environ.get(_FOR_NOW):
        return Path(for_now)
    from bodycheck._util.platform_identity import compiler  # late: it is itself kept in cache_home

    sources = digest_of(Path(__file__).parents[1] / "reference_impl")
    made_of = f"{sources} {compiler()}"
    kept = cache_home() / "kernels" / hashlib.sha256(made_of.encode()).hexdigest()[:16]
    try:
        kept.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=kept, buffering=0) as probe:
            if probe.write(_PROBE) == len(_PROBE):
                return kept
        why = os.strerror(errno.ENOSPC)
    except OSError as error:
        why = error.strerror or str(error)
    return _for_this_command(f"{cache_home()}: cannot be written: {why}", _FOR_NOW)


def _for_this_command(why: str, variable: str) -> Path:
    """Return a new folder that ends with this process, which its children find by an environment variable."""
    made = tempfile.mkdtemp(prefix="bodycheck-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    os.environ[variable] = made
    print(f"{why}; what is compiled is kept for this command alone", file=sys.stderr)
    return Path(made)


def digest_of(folder: Path) -> str:
    """Return a hash of all the Python sources in and below a folder, and of their places in it."""
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        digest.update(source.relative_to(folder).as_posix().encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()
