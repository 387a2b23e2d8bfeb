"""From a TOML file to a Scenario, or to all the file's errors at once, each with its path in the file."""

from __future__ import annotations

import tomllib
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from bodycheck.errors import InputError
from bodycheck.scenarios.body import BODY_FORMS
from bodycheck.scenarios.model import FORCING_KINDS, Scenario

_HERE = Path()


def read_scenario(path: Path) -> Scenario:
    """Read one scenario file.

    Raises InputError with one line an error: the file, the path of the key within it, what is wrong and
    what would be right.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text: {error.reason} at byte {error.start}") from None
    return parse_scenario(text, where=str(path), folder=path.parent)


def parse_scenario(text: str, where: str, folder: Traversable = _HERE) -> Scenario:
    """Read a scenario from TOML text; `where` names it in messages, its mesh file is sought from `folder`.

    Raises InputError as read_scenario does.
    """
    try:
        return Scenario.model_validate(tomllib.loads(text), context={"folder": folder})
    except RecursionError:
        raise InputError(f"{where}: is nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: is not TOML: {error}") from None
    except ValidationError as error:
        lines = [f"{where}: {_line(fault)}" for fault in error.errors(include_url=False)]
        raise InputError("\n".join(lines)) from None


def _line(fault: Any) -> str:
    """Return 'path.in.file[0]: what is wrong (it is ...)'."""
    path = _path(fault["loc"])
    match fault["type"]:
        case "missing":
            return f"{path}: is required"
        case "extra_forbidden":
            table = next((form for form in BODY_FORMS if form in fault["loc"]), "this table")
            return f"{path}: is no key of {table}"
        case "model_type":
            return f"{path}: should be a table (it is {fault['input']!r:.60})"
        case "too_long":
            return f"{path}: needs {fault['ctx']['max_length']} numbers, not {fault['ctx']['actual_length']}"
        case "value_error":
            return f"{path}: {fault['ctx']['error']}"
        case _:
            message = fault["msg"].replace("Input should", "should")
            shown = repr(fault["input"])
            return f"{path}: {message}" + (f" (it is {shown})" if len(shown) <= 60 else "")


def _path(location: tuple[int | str, ...]) -> str:
    """Return the key's path as TOML would name it: forcing[0].value_n_m[1]."""
    path = ""
    for before, part in zip((None, *location), location, strict=False):
        if part in BODY_FORMS or (isinstance(before, int) and part in FORCING_KINDS):
            continue  # pydantic names the union's member here, which is no key of the file
        path += f"[{part}]" if isinstance(part, int) else f".{part}"
    return path.lstrip(".")
