"""The built-in scenarios by name, and the suites that group them."""

from __future__ import annotations

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
        "smoke": ("intermediate-axis", "body-torque", "boxes"),
        "standard": scenario_names(),
    }


_LATER_SUITES = ("hard", "full")


def load_scenario(name: str | Path) -> Scenario:
    """Return a built-in scenario by its name, or one from the path of a TOML file.

    Raises InputError where there is no such name or file, or the file is wrong.
    """
    if isinstance(name, Path) or name.endswith(".toml") or "/" in name:
        return read_scenario(Path(name))
    if name not in scenario_names():
        raise InputError(
            f"{name}: is neither a .toml file nor a built-in scenario or suite; built in are "
            f"{', '.join(scenario_names())}; suites: {', '.join(suites())}"
        )
    return parse_scenario((_LIBRARY / f"{name}.toml").read_text(encoding="utf-8"), where=f"{name}.toml")


def load_scenarios(names: list[str]) -> list[Scenario]:
    """Return the scenarios of built-in names, suites and paths, each once, in the order asked for.

    Raises InputError with the errors of all of them, or where two different ones share a name.
    """
    scenarios: dict[str, Scenario] = {}
    faults: list[str] = []
    for asked in names:
        if asked in _LATER_SUITES:
            faults.append(f"{asked}: this suite is not yet there; so far: {', '.join(suites())}")
            continue
        for name in suites().get(asked, (asked,)):
            try:
                scenario = load_scenario(name)
            except InputError as error:
                faults.append(str(error))
                continue
            if scenarios.setdefault(scenario.name, scenario) != scenario:
                faults.append(f"{name}: another scenario of this run is named {scenario.name!r} too")
    if faults:
        raise InputError("\n".join(faults))
    return list(scenarios.values())
