"""Installed packages."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution


def installed(name: str) -> Distribution | None:
    """Return the installed distribution of this name; None if there is none."""
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)[^;]*(?:;(?:.*extra == ['\"]([\w-]+)['\"])?.*)?")


def requirements() -> dict[str, list[str]]:
    """Return the packages that bodycheck requires, by extra, in the order of pyproject.toml; "" for always.

    Extras that only combine others have the name of bodycheck itself.
    """
    found: dict[str, list[str]] = {}
    for line in distribution("bodycheck").requires or ():
        parts = _REQUIREMENT.fullmatch(line)
        assert parts is not None
        found.setdefault(parts[2] or "", []).append(parts[1])
    return found
