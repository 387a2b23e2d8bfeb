"""The cache folder: compiled kernels, truths, results of engines."""

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
_PROBE = bytes(1 << 16)  # on a full disk a file can be created but not written
_FOR_NOW = "BODYCHECK_KERNELS_FOR_NOW"
"""Passes the temporary folder that replaces the user's to child processes."""


def cache_home() -> Path:
    """Return the cache folder: ``BODYCHECK_CACHE_DIR`` [default: bodycheck in the user's cache folder]."""
    named = os.environ.get(_NAMED)
    if named:
        return Path(named)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "bodycheck")
    except RuntimeError:  # neither HOME nor an entry in the user database
        return _for_this_command("there is no home folder: set HOME or BODYCHECK_CACHE_DIR", _NAMED)


@cache
def cache_directory() -> Path:
    """Return the folder of compiled kernels, named by a hash of reference_impl's sources and the compiler.

    numba's own cache keeps using an old callee when only the callee's file has changed, so a change in any
    file of reference_impl starts an empty folder. numba's cache distinguishes numba's version and the
    processor, but not a patched numba, another llvmlite, or another NUMBA_OPT: these start an empty folder
    too. ``BODYCHECK_CACHE_DIR`` moves the folder. If it cannot be written, print a warning and return a
    temporary folder, which is removed when this process ends: numba by itself would write next to the
    sources, where changed callees go unnoticed, or give up.
    """
    if for_now := os.environ.get(_FOR_NOW):
        return Path(for_now)
    from bodycheck._util.platform_identity import compiler  # circular: it stores digests in cache_home

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
    """Return a temporary folder, removed when this process ends; children find it in a variable."""
    made = tempfile.mkdtemp(prefix="bodycheck-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    os.environ[variable] = made
    print(f"{why}; compiled code is cached for this command only", file=sys.stderr)
    return Path(made)


def digest_of(folder: Path) -> str:
    """Return a hash of the contents and relative paths of all Python sources in and below a folder."""
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        digest.update(source.relative_to(folder).as_posix().encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()
