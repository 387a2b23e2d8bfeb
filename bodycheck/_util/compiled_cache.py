"""The folder of compiled kernels: a separate one for each version of the sources and the compiler."""

from __future__ import annotations

import errno
import hashlib
import os
import tempfile
from functools import cache
from pathlib import Path

from bodycheck._util.cache_dir import cache_dir, folder_for_this_command
from bodycheck._util.file_digests import digest_of
from bodycheck._util.platform_identity import compiler

_PROBE = bytes(1 << 16)  # on a full disk a file can be created but not written
KERNELS_FOR_NOW = "BODYCHECK_KERNELS_FOR_NOW"
"""Passes the temporary folder that replaces the user's to child processes."""


@cache
def cache_directory() -> Path:
    """Return the folder of compiled kernels, named by a hash of the sources with kernels and the compiler.

    numba's own cache keeps using an old callee when only the callee's file has changed, so a change in any
    file of a package with kernels starts an empty folder. numba's cache distinguishes numba's version and the
    processor, but not a patched numba, another llvmlite, or another NUMBA_OPT: these start an empty folder
    too. ``BODYCHECK_CACHE_DIR`` moves the folder. If it cannot be written, print a warning and return a
    temporary folder, which is removed when this process ends: numba by itself would write next to the
    sources, where changed callees go unnoticed, or give up.
    """
    if for_now := os.environ.get(KERNELS_FOR_NOW):
        return Path(for_now)
    package = Path(__file__).parents[1]
    sources = [digest_of(package / folder) for folder in ("reference_impl", "scenarios/mass_properties")]
    identity = f"{' '.join(sources)} {compiler()}"
    folder = cache_dir() / "kernels" / hashlib.sha256(identity.encode()).hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder, buffering=0) as probe:
            if probe.write(_PROBE) == len(_PROBE):
                return folder
        reason = os.strerror(errno.ENOSPC)
    except OSError as error:
        reason = error.strerror or str(error)
    return folder_for_this_command(f"{cache_dir()}: cannot be written: {reason}", KERNELS_FOR_NOW)
