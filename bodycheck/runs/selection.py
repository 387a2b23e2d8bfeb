"""Select what a run measures: scenarios, methods, steps and tolerances, checked before anything runs."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

from bodycheck._util.errors import InputError, InsideWorkerError
from bodycheck._util.formatting import suggestion
from bodycheck._util.shard import Shard
from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.adapters.engine_names import engine_fault, split_method
from bodycheck.adapters.registry import default_engines, register_adapter, registered_adapter, requested_name
from bodycheck.adapters.step_function import StepModule
from bodycheck.adapters.workers.engine_pool import Announcement, announcing
from bodycheck.adapters.workers.launcher import RUN_PID
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.scenarios.library import load_any
from bodycheck.scenarios.reader import AnyScenario
from bodycheck.scenarios.user_functions import user_function

Predicate: TypeAlias = Callable[[Engine, Method], bool]
"""(engine, method) -> whether to run the method."""


@dataclass(frozen=True)
class Selection:
    """What a run measures, fully checked."""

    scenarios: tuple[tuple[str, AnyScenario], ...]
    methods: tuple[tuple[Engine, Method], ...]
    unavailable: dict[str, str]
    dt_s: tuple[float, ...] | None
    tolerances: tuple[float, ...] | None
    off_centre_only: frozenset[tuple[str, str]] = frozenset()
    """(engine, method) of unrequested methods, which run only where a link is off the centre of mass."""
    single_steps: Mapping[tuple[str, str, str], float] | None = None
    """(scenario, engine, method) -> the only step in s to run, for measurements in addition to a run."""
    shard: Shard | None = None
    """The part of `full` that is run."""
    full: Selection | None = None

    @property
    def is_adaptive(self) -> bool:
        """Whether a run adds steps where an order needs them."""
        return self.dt_s is None and self.single_steps is None

    def runs_on(self, scenario: AnyScenario, engine: Engine, method: Method) -> bool:
        """Return whether the method runs on this scenario.

        Its cases stay in one shard, because the results of some determine the steps of others.
        """
        if self.shard is not None and not self.shard.has("study", scenario.name, engine.name, method.name):
            return False
        if self.single_steps is not None:
            return (scenario.name, engine.name, method.name) in self.single_steps
        return (engine.name, method.name) not in self.off_centre_only or scenario.scene.is_off_centre

    def settings(self, scenario: AnyScenario, engine: Engine, method: Method) -> list[Setting]:
        """Return the step sizes or tolerances of a method on a scenario, coarsest first."""
        if self.single_steps is not None:
            return [Setting(dt_s=self.single_steps[scenario.name, engine.name, method.name])]
        match method.control:
            case "dt":
                return [Setting(dt_s=dt_s) for dt_s in sorted(self.dt_s or scenario.steps, reverse=True)]
            case "tolerance":
                requested = self.tolerances or method.tolerances
                return [Setting(tolerance=tolerance) for tolerance in sorted(requested, reverse=True)]
            case _:
                return [Setting()]

    def probes(self, engine: Engine, method: Method) -> bool:
        """Return whether the method is probed."""
        return self.shard is None or self.shard.has("probes", engine.name, method.name)

    def of_shard(self, shard: Shard) -> Selection:
        """Return the part of this selection that a shard runs, with those scenarios that it needs."""
        part = replace(self, shard=shard, full=self)
        needed = tuple(
            (scenario_spec, scenario)
            for scenario_spec, scenario in self.scenarios
            if any(part.runs_on(scenario, engine, method) for engine, method in self.methods)
        )
        return replace(part, scenarios=needed)

    def sentinels(self) -> list[tuple[AnyScenario, Engine, Method, Setting]]:
        """Return the cases that every shard runs: each method at its coarsest setting on one scenario.

        That is the scenario with the fewest steps among those that name no function.
        """
        scenarios = [s for _, s in self.scenarios if not s.scene.has_callback_load]
        if not scenarios:
            return []
        steps = {s.name: s.duration_s / max(self.dt_s or s.steps) for s in scenarios}
        shortest = min(scenarios, key=lambda s: (steps[s.name], s.name))
        return [
            (shortest, engine, method, self.settings(shortest, engine, method)[0])
            for engine, method in self.methods
            if self.runs_on(shortest, engine, method)
        ]

    def cases_listed(self) -> int:
        """Return the number of cases, to which a run adds steps where an order needs them."""
        return sum(
            len(self.settings(scenario, engine, method))
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
    file: Path | None = None,
    predicate: Predicate | None = None,
    partial: bool = False,
) -> Selection:
    """Resolve names, suites and paths; engines as `split_method` has them; steps in s for every scenario.

    allow_code: scenarios may name functions, whose code runs. file: has the names of the engines, unless the
    user wrote them. predicate: replaces `engines`; selects from the methods of all available engines.
    partial: an unavailable engine that was named is no error while another is available; the caller states
    which are `unavailable`.

    Raises InputError with one line per error: unknown names, wrong files, steps that do not fit.
    """
    if os.environ.get(RUN_PID):
        raise InsideWorkerError("a run cannot be started from within a worker of another run")
    for option, listed in (("scenarios", scenarios), ("engines", engines)):
        if isinstance(listed, str | Path):
            raise InputError(f"{option} must be a list of names, like [{str(listed)!r}], not a single name")
    scenarios = _names("scenarios", scenarios, str | Path)
    engines = None if engines is None else _names("engines", engines, str)
    steps, requested_tolerances = _doubles("dt_s", dt_s), _doubles("tolerances", tolerances)
    names = [split_method(name) for name in engines or default_engines()]
    _register_modules(names, allow_code=allow_code, file=file)
    requested = [name for name in dict.fromkeys(engine for engine, _, _ in names) if not engine_fault(name)]
    with announcing(requested) as announcement:
        loaded = checked_scenarios(scenarios, steps, requested_tolerances, allow_code=allow_code)
        if predicate is None:
            methods, unavailable = _methods(names, announcement, partial=partial or not engines)
        else:
            methods, unavailable = _selected_methods(predicate, announcement())
    refuse_unused_settings(methods, steps, requested_tolerances)
    selection = Selection(tuple(loaded), methods, unavailable, steps or None, requested_tolerances or None)
    off_centre = predicate is None and any(scenario.scene.is_off_centre for _, scenario in loaded)
    return _with_off_centre_methods(selection, names) if off_centre else selection


def _register_modules(names: Sequence[tuple[str, str, str]], *, allow_code: bool, file: Path | None) -> None:
    """Register modules with step functions, given as MODULE:FUNCTION, as engines of that name.

    Raises InputError where code is not allowed, or a module or function cannot be imported.
    """
    functions: dict[str, list[str]] = {}
    for engine, mark, function in names:
        known = not engine_fault(engine) and not isinstance(registered_adapter(engine), StepModule)
        if mark == ":" and not known and _is_module(engine):
            user_function(f"{engine}:{function}", allow_code=allow_code, file=file)
            functions.setdefault(engine, []).append(function)
    for engine, found in functions.items():
        register_adapter(StepModule(engine, tuple(dict.fromkeys(found))))


def _is_module(name: str) -> bool:
    """Whether a module of this name lies in the working directory."""
    path = Path(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def _with_off_centre_methods(selection: Selection, names: Sequence[tuple[str, str, str]]) -> Selection:
    """Add the variants of methods for links off the centre of mass, of engines requested as a whole."""
    complete = {name for name, colon, _ in names if not colon}
    engines = {
        engine.name: engine for engine, _ in selection.methods if requested_name(engine.name) in complete
    }
    present = {(engine.name, method.name) for engine, method in selection.methods}
    added = tuple(
        (engine, method)
        for engine in engines.values()
        for method in engine.methods.values()
        if method.is_for_off_centre_links and (engine.name, method.name) not in present
    )
    only = frozenset((engine.name, method.name) for engine, method in added)
    return replace(selection, methods=selection.methods + added, off_centre_only=only)


def _names(option: str, listed: Iterable[Any], kind: Any) -> list[Any]:
    """Return a list; raises InputError if an element is of another kind."""
    found = list(listed)
    if others := [one for one in found if not isinstance(one, kind)]:
        raise InputError(f"{option} must be a list of names, not of {type(others[0]).__name__}")
    return found


def _doubles(option: str, numbers: Iterable[float] | None) -> tuple[float, ...]:
    """Return numbers, also those of an array, as Python floats, because commands contain their repr."""
    try:
        return () if numbers is None else tuple(float(number) for number in numbers)
    except (TypeError, ValueError):
        raise InputError(f"{option} must be a list of numbers, like [0.01], not {numbers!r}") from None


def checked_scenarios(
    scenarios: Sequence[str | Path],
    dt_s: Sequence[float] | None = None,
    tolerances: Sequence[float] | None = None,
    *,
    allow_code: bool = False,
) -> list[tuple[str, AnyScenario]]:
    """Return (spec, scenario) for names, suites and paths, after checking that the steps and tolerances fit.

    Raises InputError with one line per error: unknown names, wrong files, steps that do not fit.
    """
    loaded = load_any(scenarios, allow_code=allow_code)
    faults = [
        *(
            f"{scenario.name}: {fault}"
            for _, scenario in loaded
            for fault in step_faults(scenario.scene.sample_interval_s, dt_s or ())
        ),
        *tolerance_faults(tolerances or ()),
    ]
    if faults:
        raise InputError("\n".join(faults))
    return loaded


def step_faults(sample_interval_s: float, dt_s: Sequence[float]) -> Iterator[str]:
    """Yield one line per step that does not divide the interval between samples, or is given twice."""
    strides: set[int] = set()
    for step in dt_s:
        try:
            stride = steps_per_sample(sample_interval_s, step)
        except ValueError as error:
            yield str(error)
            continue
        if stride in strides:
            yield f"the step of {step!r} s is given twice"
        strides.add(stride)


def tolerance_faults(tolerances: Sequence[float]) -> list[str]:
    """Return one line per tolerance that is out of range, or is given twice."""
    faults = [
        f"a tolerance must be a number between 0 and 1, not {tolerance!r}"
        for tolerance in tolerances
        if not 0.0 < tolerance < 1.0
    ]
    twice = [tolerance for tolerance, count in Counter(tolerances).items() if count > 1]
    return faults + [f"the tolerance {tolerance!r} is given twice" for tolerance in twice]


def refuse_unused_settings(
    methods: Iterable[tuple[Engine, Method]], dt_s: Sequence[float] | None, tolerances: Sequence[float] | None
) -> None:
    """Raise InputError, one line each, if steps or tolerances are given and no method has any."""
    controls = {method.control for _, method in methods}
    given = {"dt": ("step", dt_s), "tolerance": ("tolerance", tolerances)}
    faults = [
        f"the {word} {values[0]!r} does not apply: no selected method has a {word}"
        for control, (word, values) in given.items()
        if values and control not in controls
    ]
    if faults:
        raise InputError("\n".join(faults))


def _selected_methods(
    predicate: Predicate, found: Mapping[str, Engine | str]
) -> tuple[tuple[tuple[Engine, Method], ...], dict[str, str]]:
    engines = [engine for engine in found.values() if isinstance(engine, Engine)]
    pairs = ((engine, method) for engine in engines for method in engine.methods.values())
    unavailable = {name: engine for name, engine in found.items() if isinstance(engine, str)}
    return tuple(pair for pair in pairs if predicate(*pair)), unavailable


def _methods(
    names: Sequence[tuple[str, str, str]], announcement: Announcement, *, partial: bool
) -> tuple[tuple[tuple[Engine, Method], ...], dict[str, str]]:
    """Return the requested methods, or all methods of all available engines, and why engines are unavailable.

    partial: whether an unavailable engine is an error only if no other is available.
    """
    engine_names = dict.fromkeys(engine for engine, _, _ in names)
    faults = [fault for engine in engine_names if (fault := engine_fault(engine))]
    found = announcement()
    unavailable = {name: engine for name, engine in found.items() if isinstance(engine, str)}
    if not partial or len(unavailable) == len(found):
        faults += unavailable.values()
    methods: dict[tuple[str, str], tuple[Engine, Method]] = {}
    for name, colon, method in names:
        engine = found.get(name)
        if not isinstance(engine, Engine):
            continue
        if colon and method not in engine.methods:
            faults.append(f"{name} has no method {method!r}{suggestion(method, engine.methods)}")
            continue
        fair = [name for name, facts in engine.methods.items() if not facts.on_request]
        for chosen in [method] if colon else fair:
            methods[name, chosen] = (engine, engine.methods[chosen])
    if faults:
        raise InputError("\n".join(faults))
    return tuple(methods.values()), unavailable
