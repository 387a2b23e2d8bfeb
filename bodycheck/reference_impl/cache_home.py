"""Where bodycheck keeps what it need not compute again: compiled kernels, truths, answers of engines."""

from __future__ import annotations

import os
from pathlib import Path


def cache_home() -> Path:
    """Return the folder; ``BODYCHECK_CACHE_DIR`` names another than the user's cache folder."""
    named = os.environ.get("BODYCHECK_CACHE_DIR")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "bodycheck")
