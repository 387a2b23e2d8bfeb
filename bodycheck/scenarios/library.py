"""The built-in scenarios by name, and the suites that group them."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import nearest, suggestion
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import (
    AnyScenario,
    parse_any,
    parse_members,
    parse_trees,
    read_any,
    read_members,
    read_trees,
)

if TYPE_CHECKING:
    from bodycheck.scenarios.tree_model import TreeScenario

_LIBRARY = files("bodycheck.scenarios") / "library"
_TREES = _LIBRARY / "trees"

PROBES = ("probe", "probe-free")
"""Scenarios that every run uses to probe each method, besides the requested ones; part of no suite."""
OF_NO_SUITE = ("nesc-tumbling-brick", "quick")
"""A published recording, for `judge --like`, and a scenario for engines of which smoke takes minutes."""

STANDARD_TREES = ("free-chain", "double-pendulum")
"""Trees of the suite standard."""


def scenario_names() -> tuple[str, ...]:
    """Return the names of the built-in scenarios and families, in alphabetical order."""
    return tuple(sorted(entry.name[:-5] for entry in _LIBRARY.iterdir() if entry.name.endswith(".toml")))


def tree_names() -> tuple[str, ...]:
    """Return the names of the built-in trees of bodies, in alphabetical order."""
    return tuple(sorted(entry.name[:-5] for entry in _TREES.iterdir()))


@cache
def suites() -> dict[str, tuple[str, ...]]:
    """Return the suites: name -> scenario names.

    The tags "forcings" and "hard" put a scenario into the suite of that name; standard has those without, and
    two trees of bodies.
    """
    full = tuple(name for name in scenario_names() if name not in (*PROBES, *OF_NO_SUITE))
    tags = {name: _file(name).get("tags", ()) for name in full}
    forcings, hard = (tuple(name for name in full if tag in tags[name]) for tag in ("forcings", "hard"))
    return {
        "smoke": ("free-flight", "powered-flight", "fast-flight"),
        "standard": (*(name for name in full if name not in (*forcings, *hard)), *STANDARD_TREES),
        "forcings": forcings,
        "hard": hard,
        "trees": tree_names(),
        "full": (*full, *tree_names()),
    }


def as_suite(names: Sequence[str]) -> Sequence[str]:
    """Return the name of the suite that has exactly these scenarios, or else the names."""
    suite = next((suite for suite, members in suites().items() if {*members} == {*names}), None)
    return names if suite is None else [suite]


def scenario_summaries() -> dict[str, str]:
    """Return name -> one-line summary of the built-in scenarios, without computing their bodies."""
    return {name: _file(name)["summary"] for name in scenario_names()}


def tree_summaries() -> dict[str, str]:
    """Return name -> one-line summary of the built-in trees."""
    return {name: tomllib.loads(_text(name))["summary"] for name in tree_names()}


def _file(name: str) -> dict[str, Any]:
    return tomllib.loads(_text(name))


def _text(name: str) -> str:
    """Return the file of a built-in scenario or tree."""
    folder = _TREES if name in tree_names() else _LIBRARY
    return (folder / f"{name}.toml").read_text(encoding="utf-8")


def load_trees(name: str | Path) -> list[tuple[str, TreeScenario]]:
    """Return (spec, tree) for a built-in tree, or for the tree or the family of trees in a TOML file.

    Raises InputError if there is no such name or file, the file is wrong, or has one [body].
    """
    if str(name) in tree_names():
        members = parse_trees(_text(str(name)), where=f"{name}.toml", folder=_TREES)
    elif isinstance(name, Path) or name.endswith(".toml") or "/" in name:
        members = read_trees(Path(name))
    else:
        near = suggestion(name, tree_names())
        raise InputError(f"{name}: is neither a .toml file nor a built-in tree{near}")
    return [(f"{name}" if label is None else f"{name}/{label}", tree) for label, tree in members.items()]


def load_scenario(name: str | Path, *, allow_code: bool = False) -> Scenario:
    """Return a built-in scenario by its name, or a scenario from the path of a TOML file.

    A child of a family is named by its value after a slash: NAME/VALUE or FILE.toml/VALUE. allow_code: the
    file may name functions, whose code runs.

    Raises InputError if there is no such name or file, or the file is wrong.
    """
    return cast("Scenario", _only(name, allow_code=allow_code, trees=False))


def load_one(name: str | Path, *, allow_code: bool = False) -> AnyScenario:
    """Return a scenario as `load_scenario` does, or a tree."""
    return _only(name, allow_code=allow_code, trees=True)


def _only(name: str | Path, *, allow_code: bool, trees: bool) -> AnyScenario:
    if not isinstance(name, str | Path):
        raise InputError(f"a scenario must be a name or a path, not {name!r}")
    if members := suites().get(str(name)):
        raise InputError(f"{name}: is a suite; name one of its scenarios: {', '.join(members)}")
    found = _members(name, allow_code=allow_code, trees=trees)
    if len(found) > 1:
        raise InputError(
            f"{name}: is a family; name one of its scenarios: {', '.join(spec for spec, _ in found)}"
        )
    return found[0][1]


def load_scenarios(specs: Sequence[str | Path], *, allow_code: bool = False) -> list[tuple[str, Scenario]]:
    """Return (spec, scenario) as `load_any` does, without the trees of suites.

    Raises InputError also for a tree that is named.
    """
    of_suites = [
        name for one in specs for name in suites().get(str(one), (one,)) if name not in _in_suites(one)
    ]
    return cast("list[tuple[str, Scenario]]", _loaded(of_suites, allow_code=allow_code, trees=False))


def _in_suites(spec: str | Path) -> Sequence[str]:
    """Return the trees of a suite; none for anything else."""
    return tree_names() if str(spec) in suites() else ()


def load_any(specs: Sequence[str | Path], *, allow_code: bool = False) -> list[tuple[str, AnyScenario]]:
    """Return (spec, scenario) for names, suites and paths, also of trees; a family gives all its children.

    Duplicates are dropped. Raises InputError with all errors, or if two different scenarios share a name.
    """
    members = [member for one in specs for member in suites().get(str(one), (one,))]
    return _loaded(members, allow_code=allow_code, trees=True)


def _loaded(names: Sequence[str | Path], *, allow_code: bool, trees: bool) -> list[tuple[str, AnyScenario]]:
    found: dict[str, tuple[str, AnyScenario]] = {}
    faults: list[str] = []
    for name in names:
        try:
            members = _members(name, allow_code=allow_code, trees=trees)
        except InputError as error:
            faults.append(str(error))
            continue
        for spec, scenario in members:
            if found.setdefault(scenario.name, (spec, scenario))[1] != scenario:
                faults.append(f"{spec}: another scenario of this run is also named {scenario.name!r}")
    if faults:
        raise InputError("\n".join(faults))
    return list(found.values())


def _members(name: str | Path, *, allow_code: bool, trees: bool) -> list[tuple[str, AnyScenario]]:
    """Return (spec, scenario) for all scenarios of a name; the spec names a single scenario."""
    source, child = _source_and_child(name)
    members = _read(source, allow_code=allow_code, trees=trees)
    found = [
        (str(source) if label is None else f"{source}/{label}", scenario)
        for label, scenario in members.items()
        if child is None or (label is not None and _same(label, child))
    ]
    if not found:
        there = ", ".join(f"{source}/{label}" for label in members if label is not None)
        raise InputError(
            f"{name}: not in this family (available: {there})"
            if there
            else f"{name}: {source} is a single scenario, not a family"
        )
    return found


def _source_and_child(name: str | Path) -> tuple[str | Path, str | None]:
    """Split the name of a child into family and value, which may contain slashes like the path of a mesh."""
    text = str(name)
    if text.endswith(".toml"):
        return name, None
    file, inside, value = text.rpartition(".toml/")
    if inside:
        return f"{file}.toml", value
    family, slash, value = text.partition("/")
    return (family, value) if slash and family in scenario_names() else (name, None)


def _same(label: str, value: str) -> bool:
    """Return whether two values are equal as text or as numbers: 1e-3 is 0.001."""
    try:
        return label == value or float(label) == float(value)
    except ValueError:
        return False


def _read(name: str | Path, *, allow_code: bool, trees: bool) -> Mapping[str | None, AnyScenario]:
    if isinstance(name, Path) or name.endswith(".toml") or "/" in name:
        return (read_any if trees else read_members)(Path(name), allow_code=allow_code)
    if name not in (*scenario_names(), *tree_names()):
        raise InputError(f"{name}: is neither a .toml file nor a built-in scenario or suite; {_hint(name)}")
    return (parse_any if trees else parse_members)(_text(name), where=f"{name}.toml", folder=_LIBRARY)


def _hint(name: str) -> str:
    """Return a question with the file or built-in name that resembles this one, else all names."""
    if os.path.isfile(f"{name}.toml"):  # noqa: PTH113 - accepts names of any length
        return f"did you mean {name}.toml?"
    if near := nearest(name, (*scenario_names(), *suites())):
        return f"did you mean {near}?"
    return f"built-in scenarios: {', '.join(scenario_names())}; suites: {', '.join(suites())}"
