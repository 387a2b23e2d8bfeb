"""The cache folder: compiled kernels, truths, results of engines."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from pathlib import Path

_VARIABLE = "BODYCHECK_CACHE_DIR"


def cache_dir() -> Path:
    """Return the cache folder: ``BODYCHECK_CACHE_DIR`` [default: bodycheck in the user's cache folder]."""
    configured = os.environ.get(_VARIABLE)
    if configured:
        return Path(configured)
    try:
        if sys.platform == "linux":
            return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "bodycheck")
        from platformdirs import user_cache_path  # required on other systems only

        return user_cache_path("bodycheck", appauthor=False)
    except RuntimeError:  # neither HOME nor an entry in the user database
        return folder_for_this_command("there is no home folder: set HOME or BODYCHECK_CACHE_DIR", _VARIABLE)


def folder_for_this_command(reason: str, variable: str) -> Path:
    """Return a new folder that ends with this process, which children find by an environment variable."""
    made = tempfile.mkdtemp(prefix="bodycheck-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    os.environ[variable] = made
    print(f"{reason}; compiled code is cached for this command only", file=sys.stderr)
    return Path(made)
