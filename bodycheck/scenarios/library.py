"""The built-in scenarios by name, and the suites that group them."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from bodycheck.errors import InputError
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_scenario, read_scenario

_LIBRARY = files("bodycheck.scenarios") / "library"


def scenario_names() -> tuple[str, ...]:
    """Return the names of the built-in scenarios, in alphabetical order."""
    return tuple(sorted(entry.name[:-5] for entry in _LIBRARY.iterdir() if entry.name.endswith(".toml")))


def suites() -> dict[str, tuple[str, ...]]:
    """Return the suites: name -> scenario names."""
    return {
        "smoke": ("intermediate-axis", "full-tensor", "body-torque"),
        "standard": scenario_names(),
    }


def scenario_summaries() -> dict[str, str]:
    """Return the built-in scenarios' one-line summaries, by name, without working out their bodies."""
    texts = ((name, (_LIBRARY / f"{name}.toml").read_text(encoding="utf-8")) for name in scenario_names())
    return {name: tomllib.loads(text)["summary"] for name, text in texts}


_LATER_SUITES = ("hard", "full")


def load_scenario(name: str | Path) -> Scenario:
    """Return a built-in scenario by its name, or one from the path of a TOML file.

    Raises InputError where there is no such name or file, or the file is wrong.
    """
    if isinstance(name, Path) or name.endswith(".toml") or "/" in name:
        return read_scenario(Path(name))
    if name in _LATER_SUITES:
        raise InputError(f"{name}: this suite is not yet there; so far: {', '.join(suites())}")
    if name not in scenario_names():
        raise InputError(
            f"{name}: is neither a .toml file nor a built-in scenario or suite; built in are "
            f"{', '.join(scenario_names())}; suites: {', '.join(suites())}"
        )
    text = (_LIBRARY / f"{name}.toml").read_text(encoding="utf-8")
    return parse_scenario(text, where=f"{name}.toml", folder=_LIBRARY)


def load_scenarios(asked: Sequence[str | Path]) -> list[tuple[str, Scenario]]:
    """Return the scenarios of built-in names, suites and paths, each once, with what names it here.

    Raises InputError with the errors of all of them, or where two different ones share a name.
    """
    found: dict[str, tuple[str, Scenario]] = {}
    faults: list[str] = []
    for name in (member for one in asked for member in suites().get(str(one), (one,))):
        try:
            scenario = load_scenario(name)
        except InputError as error:
            faults.append(str(error))
            continue
        if found.setdefault(scenario.name, (str(name), scenario))[1] != scenario:
            faults.append(f"{name}: another scenario of this run is named {scenario.name!r} too")
    if faults:
        raise InputError("\n".join(faults))
    return list(found.values())
