"""Which releases of an engine a registry has for this Python."""

from __future__ import annotations

import sys

from bodycheck.adapters.pins import engine_fault, is_version
from bodycheck.adapters.registry import distribution_of
from bodycheck.adapters.uv import UvError, uv
from bodycheck.errors import InputError


def releases(engine: str, since: str, until: str | None) -> tuple[str, ...]:
    """Return the releases from `since` to `until`, both included, oldest first; until None: to the newest.

    Only those that have a wheel for this Python; no pre-releases, none that was withdrawn. uv is asked for
    the newest, then for the newest before that: it has no list, but knows what can be installed.

    Raises InputError where there is none or a version is none, UnavailableError where uv cannot tell.
    """
    for option, version in (("--since", since), ("--until", until)):
        if version is not None and not is_version(version):
            raise InputError(f"{option} {version}: is no version; give one like 3.6.0")
    if fault := engine_fault(f"{engine}=={since}"):
        raise InputError(fault)
    found: list[str] = []
    below = "" if until is None else f",<={until}"
    while True:
        try:
            found.append(_newest(f"{distribution_of(engine)}>={since}{below}"))
        except UvError as error:
            if not error.refused:
                raise
            if not found:
                raise InputError(f"{engine}: no release that can be installed here: {error}") from None
            return tuple(reversed(found))
        below = f",<{found[-1]}"


def _newest(requirement: str) -> str:
    """Return the newest version that meets the requirement."""
    line = uv(
        *("pip", "compile", "--python", sys.executable, "--no-deps", "--no-build", "--no-header"),
        *("--no-annotate", "--prerelease", "disallow", "-"),
        given=f"{requirement}\n",
    )
    return line.strip().partition("==")[2]
