"""Where bodycheck keeps what it need not compute again: compiled kernels, truths, answers of engines."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from pathlib import Path

_NAMED = "BODYCHECK_CACHE_DIR"


def cache_home() -> Path:
    """Return the folder; ``BODYCHECK_CACHE_DIR`` names another than the user's cache folder."""
    named = os.environ.get(_NAMED)
    if named:
        return Path(named)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "bodycheck")
    except RuntimeError:  # neither HOME nor an entry among the users
        return folder_for_this_command("there is no home folder: set HOME or BODYCHECK_CACHE_DIR", _NAMED)


def folder_for_this_command(why: str, variable: str) -> Path:
    """Return a new folder that ends with this process, which its children find by an environment variable."""
    made = tempfile.mkdtemp(prefix="bodycheck-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    os.environ[variable] = made
    print(f"{why}; what is compiled is kept for this command alone", file=sys.stderr)
    return Path(made)
