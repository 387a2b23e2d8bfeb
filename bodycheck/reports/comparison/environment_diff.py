"""Differences of machine, versions and settings between two runs, and the steps that each chose itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bodycheck.scenarios.model import DEFAULT_STEPS_PER_SAMPLE

_MACHINE = ("cpu", "cores", "platform")
_SOFTWARE = ("bodycheck", "python")
_SETTINGS = ("dt_s", "tolerances", "speed", "timeout_s")
_NOT_SIMULATED = ("summary", "source", "tags", "steps_s")  # keys that do not affect the motion

_Manifest = Mapping[str, Any]

BUILD_OF = "build of"
"""The beginning of the difference that reports a different build of the same version."""


def same_machine(before: _Manifest, after: _Manifest) -> bool:
    """Whether both runs were made on the same machine, so that times in seconds are comparable."""
    return all(before.get(key) == after.get(key) for key in _MACHINE)


def environment_diff(before: _Manifest, after: _Manifest) -> tuple[str, ...]:
    """Return the differences of environment as `name: before -> after`; builds of one version come first."""
    builds = rebuilt(before, after)
    pairs = [(key, before.get(key), after.get(key)) for key in (*_MACHINE, *_SOFTWARE)]
    for table, text_of in (("engines", _version), ("libraries", str)):
        old, new = before.get(table, {}), after.get(table, {})
        pairs += [(name, text_of(old.get(name)), text_of(new.get(name))) for name in {**old, **new}]
    pairs += [(key, before.get(key), after.get(key)) for key in _SETTINGS]
    return (*builds, *(f"{name}: {_text(a)} -> {_text(b)}" for name, a, b in pairs if a != b))


def rebuilt(before: _Manifest, after: _Manifest) -> tuple[str, ...]:
    """Return the engines with equal versions but different builds, and the parts that differ."""
    old, new = before.get("engines", {}), after.get("engines", {})
    both = [(name, old[name], new[name]) for name in new if name in old]
    return tuple(
        f"{BUILD_OF} {name} {b['version']}: {_ids(a)} -> {_ids(b)}{_differing_parts(a, b)}"
        for name, a, b in both
        if "build" in a and "build" in b and a["version"] == b["version"] and _ids(a) != _ids(b)
    )


def _ids(engine: Mapping[str, Any]) -> str:
    """Return the builds that produced results; if none is known, the announced one."""
    return ", ".join(engine.get("builds") or [engine["build"]["id"][:12] or "unknown"])


def _differing_parts(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Return the names of the parts that differ, in parentheses."""
    old, new = before["build"]["parts"], after["build"]["parts"]
    names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    return f" ({', '.join(names)})" if names else ""


def _version(engine: Mapping[str, Any] | None) -> str | None:
    if engine is None:
        return None
    return str(engine["version"]) if "version" in engine else "unavailable"


def _text(value: Any) -> str:
    return "none" if value is None else str(value)


def redefined(before: _Manifest, after: _Manifest) -> tuple[str, ...]:
    """Return the scenarios that have the same name in both runs but different definitions."""
    both = before["scenarios"].keys() & after["scenarios"].keys()
    return tuple(
        name
        for name in after["scenarios"]
        if name in both and simulated(before["scenarios"][name]) != simulated(after["scenarios"][name])
    )


def simulated(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """Return what affects results of a scenario in a manifest."""
    found = {key: value for key, value in scenario.items() if key not in _NOT_SIMULATED}
    match found.get("body"):
        case {"mesh": {"surface": _, **facts}, **others}:  # drawn only; absent from runs of earlier versions
            found["body"] = {**others, "mesh": facts}
    return found


_SAME = 1e-9  # relative tolerance at which two steps count as equal


def is_refinement(row: Mapping[str, Any], manifest: Mapping[str, Any]) -> bool:
    """Whether a run chose the step of a case itself, so that the case is neither new nor missing elsewhere.

    row: a row of results.csv. manifest: of its run. If the requested steps are unknown, the run chose none.
    """
    if row["control"] != "dt" or row.get("dt_s") is None:
        return False
    requested = manifest.get("dt_s") or _listed(manifest["scenarios"].get(row["scenario"], {}))
    return bool(requested) and not any(math.isclose(row["dt_s"], step, rel_tol=_SAME) for step in requested)


def _listed(scenario: Mapping[str, Any]) -> list[float]:
    """Return the default steps of a scenario as stored in a manifest."""
    if scenario.get("steps_s"):
        return list(scenario["steps_s"])
    if not {"duration_s", "samples"} <= scenario.keys():
        return []
    interval = scenario["duration_s"] / (scenario["samples"] - 1)
    return [interval / n for n in DEFAULT_STEPS_PER_SAMPLE]
