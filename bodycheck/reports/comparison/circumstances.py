"""Under what different circumstances two runs were made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_MACHINE = ("cpu", "cores", "platform")
_SOFTWARE = ("bodycheck", "python")
_SETTINGS = ("dt_s", "tolerances", "speed", "timeout_s")
_IDLE = ("summary", "source", "tags", "steps_s")  # keys of a scenario that do not change what is simulated

_Manifest = Mapping[str, Any]


def same_machine(before: _Manifest, after: _Manifest) -> bool:
    """Whether times in seconds can be compared."""
    return all(before.get(key) == after.get(key) for key in _MACHINE)


def circumstances(before: _Manifest, after: _Manifest) -> tuple[str, ...]:
    """Return each circumstance that differs, as `name: before -> after`."""
    pairs = [(key, before.get(key), after.get(key)) for key in (*_MACHINE, *_SOFTWARE)]
    for table, words in (("engines", _version), ("libraries", str)):
        old, new = before.get(table, {}), after.get(table, {})
        pairs += [(name, words(old.get(name)), words(new.get(name))) for name in {**old, **new}]
    pairs += [(key, before.get(key), after.get(key)) for key in _SETTINGS]
    return tuple(f"{name}: {_shown(a)} -> {_shown(b)}" for name, a, b in pairs if a != b)


def _version(engine: Mapping[str, Any] | None) -> str | None:
    if engine is None:
        return None
    return str(engine["version"]) if "version" in engine else "unavailable"


def _shown(value: Any) -> str:
    return "none" if value is None else str(value)


def redefined(before: _Manifest, after: _Manifest) -> tuple[str, ...]:
    """Return the scenarios of both runs that are the same by their names alone."""
    both = before["scenarios"].keys() & after["scenarios"].keys()
    return tuple(
        name
        for name in after["scenarios"]
        if name in both and _simulated(before["scenarios"][name]) != _simulated(after["scenarios"][name])
    )


def _simulated(scenario: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in scenario.items() if key not in _IDLE}
