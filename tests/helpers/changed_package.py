"""A copy of the package to which one text is added, as recipes of CONTRIBUTING.md add it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import bodycheck


def copy_with(folder: Path, file: str, place: str, added: str) -> None:
    """Copy the package into a folder, and insert a text before the only place of another one in a file."""
    package = Path(bodycheck.__file__).parent
    shutil.copytree(package, folder / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    path = folder / file
    text = path.read_text()
    assert text.count(place) == 1
    path.write_text(text.replace(place, added + place))


def printed_by(folder: Path, *words: str) -> str:
    """Return what the copy in a folder prints for the words of a command, which ends with status 0."""
    command = [sys.executable, "-m", "bodycheck", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout
