"""The gate for code that text names: programs and functions, from the user or from data."""

from __future__ import annotations

import json
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import read_text


def check_code(name: str, effect: str, *, allow_code: bool, file: Path | None = None) -> None:
    """Raise InputError unless the code of this name may run.

    Whatever starts a program, or imports a module, whose name is text from outside calls this first.
    effect: what the name does. allow_code: whether the user wrote the name on the command line or in a call,
    or gave --allow-code. file: the file that has the name; None if the user wrote it. The message has its
    line.
    """
    if allow_code:
        return
    place = "it" if file is None else _place(name, file)
    raise InputError(f"{name}: {effect}; add --allow-code if you trust {place}")


def _place(name: str, file: Path) -> str:
    """Return FILE:LINE of the first line with the name, as text, or as a string of JSON or TOML."""
    spellings = {name, json.dumps(name)[1:-1]}
    try:
        lines = read_text(file).splitlines()
    except InputError:
        lines = []
    found = (k for k, line in enumerate(lines, 1) if any(one in line for one in spellings))
    line = next(found, None)
    return str(file) if line is None else f"{file}:{line}"
