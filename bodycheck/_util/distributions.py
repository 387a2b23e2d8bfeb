"""Installed packages."""

from __future__ import annotations

from importlib.metadata import Distribution, PackageNotFoundError, distribution


def installed(name: str) -> Distribution | None:
    """Return the installed distribution of this name; None if there is none."""
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None
