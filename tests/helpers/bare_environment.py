"""A virtual environment without extras: links to those installed packages that some packages require."""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement


def make_environment(folder: Path, packages: Iterable[str]) -> Path:
    """Make an environment with these packages and all that they require, and return its folder of programs.

    Nothing is downloaded; an extra is named as pip does: bodycheck[history].
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (inside,) = folder.glob("lib/python*/site-packages")
    here = Path(sysconfig.get_path("purelib"))
    for entry in {file.parts[0] for name in _closure(packages) for file in distribution(name).files or ()}:
        if entry != ".." and (here / entry).exists():
            (inside / entry).symlink_to(here / entry)
    programs = folder / "bin"
    (programs / "bodycheck").write_text(f'#!/bin/sh\nexec {programs}/python -P -m bodycheck "$@"\n')
    (programs / "bodycheck").chmod(0o755)
    return programs


def _closure(packages: Iterable[str]) -> set[str]:
    """Return the names of the packages and of all that they require on this Python, where installed."""
    waiting = [Requirement(one) for one in packages]
    seen: set[tuple[str, str]] = set()
    found: set[str] = set()
    while waiting:
        requirement = waiting.pop()
        for extra in ("", *requirement.extras):
            key = (re.sub(r"[-_.]+", "-", requirement.name).lower(), extra)
            if key in seen:
                continue
            seen.add(key)
            try:
                lines = distribution(requirement.name).requires or ()
            except PackageNotFoundError:
                continue
            found.add(requirement.name)
            waiting += [one for one in map(Requirement, lines) if _applies(one, extra)]
    return found


def _applies(requirement: Requirement, extra: str) -> bool:
    return requirement.marker is None or requirement.marker.evaluate({"extra": extra})
