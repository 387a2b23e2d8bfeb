"""Select what a run measures: scenarios, methods, steps and tolerances, checked before anything runs."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from bodycheck._util.errors import InputError, InsideWorkerError
from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.adapters.registry import engine_names
from bodycheck.adapters.versions.pins import engine_fault
from bodycheck.adapters.workers.engine_pool import Announcement, announcing
from bodycheck.adapters.workers.worker import RUN_PID
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.scenarios.library import load_scenarios
from bodycheck.scenarios.model import Scenario

Wanted: TypeAlias = Callable[[Engine, Method], bool]
"""(engine, method) -> whether to run the method."""


@dataclass(frozen=True)
class Selection:
    """What a run measures, fully checked."""

    scenarios: tuple[tuple[str, Scenario], ...]
    methods: tuple[tuple[Engine, Method], ...]
    unavailable: dict[str, str]
    dt_s: tuple[float, ...] | None
    tolerances: tuple[float, ...] | None
    off_centre_only: frozenset[tuple[str, str]] = frozenset()
    """(engine, method) of unrequested methods, which run only where a link is off the centre of mass."""

    def runs_on(self, scenario: Scenario, engine: Engine, method: Method) -> bool:
        """Return whether the method runs on this scenario."""
        return (engine.name, method.name) not in self.off_centre_only or scenario.scene.is_off_centre

    def settings(self, scenario: Scenario, method: Method) -> list[Setting]:
        """Return the step sizes or tolerances of a method on a scenario, coarsest first."""
        match method.control:
            case "dt":
                return [Setting(dt_s=dt_s) for dt_s in sorted(self.dt_s or scenario.steps, reverse=True)]
            case "tolerance":
                asked = self.tolerances or method.tolerances
                return [Setting(tolerance=tolerance) for tolerance in sorted(asked, reverse=True)]
            case _:
                return [Setting()]

    def cases_listed(self) -> int:
        """Return the number of cases, to which a run adds steps where an order needs them."""
        return sum(
            len(self.settings(scenario, method))
            for _, scenario in self.scenarios
            for engine, method in self.methods
            if self.runs_on(scenario, engine, method)
        )


def select(
    scenarios: Sequence[str | Path] = ("standard",),
    engines: Sequence[str] | None = None,
    dt_s: Iterable[float] | None = None,
    tolerances: Iterable[float] | None = None,
    *,
    allow_code: bool = False,
    wanted: Wanted | None = None,
) -> Selection:
    """Resolve names, suites and paths; engines as NAME[==VERSION][:METHOD]; steps in s for every scenario.

    allow_code: scenarios may name functions, whose code runs. wanted: replaces `engines`; selects among the
    methods of all available engines.

    Raises InputError with one line per error: unknown names, wrong files, steps that do not fit.
    """
    if os.environ.get(RUN_PID):
        raise InsideWorkerError("a run cannot be started from within a worker of another run")
    for what, listed in (("scenarios", scenarios), ("engines", engines)):
        if isinstance(listed, str):
            raise InputError(f"{what} must be a list of names, like [{listed!r}], not a string")
    steps, asked_tolerances = _doubles("dt_s", dt_s), _doubles("tolerances", tolerances)
    names = [_parted(name) for name in engines or engine_names()]
    asked = [name for name in dict.fromkeys(engine for engine, _, _ in names) if not engine_fault(name)]
    with announcing(asked) as announcement:
        loaded = checked_scenarios(scenarios, steps, asked_tolerances, allow_code=allow_code)
        if wanted is None:
            methods, unavailable = _methods(names, announcement, by_name=bool(engines))
        else:
            methods, unavailable = _wanted_methods(wanted, announcement())
    selection = Selection(tuple(loaded), methods, unavailable, steps or None, asked_tolerances or None)
    off_centre = wanted is None and any(scenario.scene.is_off_centre for _, scenario in loaded)
    return _with_off_centre_methods(selection, names) if off_centre else selection


def _with_off_centre_methods(selection: Selection, names: Sequence[tuple[str, str, str]]) -> Selection:
    """Add the variants of methods for links off the centre of mass, of engines requested as a whole."""
    whole = {name for name, colon, _ in names if not colon}
    engines = {engine.name: engine for engine, _ in selection.methods if engine.name in whole}
    present = {(engine.name, method.name) for engine, method in selection.methods}
    added = tuple(
        (engine, method)
        for engine in engines.values()
        for method in engine.methods.values()
        if method.is_for_off_centre_links and (engine.name, method.name) not in present
    )
    only = frozenset((engine.name, method.name) for engine, method in added)
    return replace(selection, methods=selection.methods + added, off_centre_only=only)


def _doubles(what: str, numbers: Iterable[float] | None) -> tuple[float, ...]:
    """Return numbers, also those of an array, as Python floats, because commands contain their repr."""
    try:
        return () if numbers is None else tuple(float(number) for number in numbers)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be a list of numbers, like [0.01], not {numbers!r}") from None


def checked_scenarios(
    scenarios: Sequence[str | Path],
    dt_s: Sequence[float] | None = None,
    tolerances: Sequence[float] | None = None,
    *,
    allow_code: bool = False,
) -> list[tuple[str, Scenario]]:
    """Return (spec, scenario) for names, suites and paths, after checking that the steps and tolerances fit.

    Raises InputError with one line per error: unknown names, wrong files, steps that do not fit.
    """
    loaded = load_scenarios(scenarios, allow_code=allow_code)
    faults = [*_step_faults(loaded, dt_s or ()), *_tolerance_faults(tolerances or ())]
    if faults:
        raise InputError("\n".join(faults))
    return loaded


def _step_faults(loaded: Sequence[tuple[str, Scenario]], dt_s: Sequence[float]) -> list[str]:
    faults = []
    for _, scenario in loaded:
        seen: set[int] = set()
        for step in dt_s:
            try:
                stride = steps_per_sample(scenario.scene.sample_interval_s, step)
            except ValueError as error:
                faults.append(f"{scenario.name}: {error}")
                continue
            if stride in seen:
                faults.append(f"{scenario.name}: the step of {step!r} s is given twice")
            seen.add(stride)
    return faults


def _tolerance_faults(tolerances: Sequence[float]) -> list[str]:
    faults = [
        f"a tolerance must be a number between 0 and 1, not {tolerance!r}"
        for tolerance in tolerances
        if not 0.0 < tolerance < 1.0
    ]
    twice = [tolerance for tolerance, count in Counter(tolerances).items() if count > 1]
    return faults + [f"the tolerance {tolerance!r} is given twice" for tolerance in twice]


def _wanted_methods(
    wanted: Wanted, found: Mapping[str, Engine | str]
) -> tuple[tuple[tuple[Engine, Method], ...], dict[str, str]]:
    engines = [engine for engine in found.values() if isinstance(engine, Engine)]
    pairs = ((engine, method) for engine in engines for method in engine.methods.values())
    unavailable = {name: engine for name, engine in found.items() if isinstance(engine, str)}
    return tuple(pair for pair in pairs if wanted(*pair)), unavailable


def _parted(name: str) -> tuple[str, str, str]:
    """Split NAME[==VERSION][:METHOD] into engine, colon (or '') and method."""
    engine, colon, method = name.partition(":")
    return "==".join(part.strip() for part in engine.split("==")), colon, method.strip()


def _methods(
    names: Sequence[tuple[str, str, str]], announcement: Announcement, *, by_name: bool
) -> tuple[tuple[tuple[Engine, Method], ...], dict[str, str]]:
    """Return the requested methods, or all methods of all available engines, and why engines are unavailable.

    by_name: whether the engines were requested by name, so that an unavailable one is an error.
    """
    asked = dict.fromkeys(engine for engine, _, _ in names)
    faults = [fault for engine in asked if (fault := engine_fault(engine))]
    found = announcement()
    unavailable = {name: engine for name, engine in found.items() if isinstance(engine, str)}
    if by_name:
        faults += unavailable.values()
    methods: dict[tuple[str, str], tuple[Engine, Method]] = {}
    for name, colon, method in names:
        engine = found.get(name)
        if not isinstance(engine, Engine):
            continue
        if colon and method not in engine.methods:
            faults.append(f"{name} has no method {method!r} (available: {', '.join(engine.methods)})")
            continue
        fair = [name for name, facts in engine.methods.items() if not facts.on_request]
        for chosen in [method] if colon else fair:
            methods[name, chosen] = (engine, engine.methods[chosen])
    if faults:
        raise InputError("\n".join(faults))
    return tuple(methods.values()), unavailable
