"""Running scenarios through engines: what was asked for, in which order, and under what circumstances."""

from __future__ import annotations

import os
import platform
import secrets
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bodycheck.adapters.contract import Adapter, Method
from bodycheck.adapters.registry import engine_names, get_adapter
from bodycheck.errors import InputError, UnavailableError
from bodycheck.reference_impl.truth import Truth, solve_truth
from bodycheck.reference_impl.warm_up import compile_kernels
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.reports.case import CaseResult, Subject
from bodycheck.reports.judge import judge_file
from bodycheck.reports.run import Run
from bodycheck.reports.study import study
from bodycheck.reports.tables import METHOD_COLUMNS, RESULT_COLUMNS, as_table
from bodycheck.scenarios.library import load_scenario, load_scenarios
from bodycheck.scenarios.model import Scenario


@dataclass(frozen=True)
class Selection:
    """What a run is to measure, checked: nothing in it can be refused any more."""

    scenarios: tuple[tuple[str, Scenario], ...]
    methods: tuple[tuple[Adapter, Method], ...]
    unavailable: dict[str, str]
    dt_s: tuple[float, ...] | None

    def cases_listed(self) -> int:
        """Return how many cases there are at least; a run adds steps where an order needs them."""
        stepped = sum(method.control == "dt" for _, method in self.methods)
        steps = sum(len(self.dt_s or scenario.steps) for _, scenario in self.scenarios)
        return steps * stepped + len(self.scenarios) * (len(self.methods) - stepped)


def select(
    scenarios: Sequence[str | Path] = ("standard",),
    engines: Sequence[str] | None = None,
    dt_s: Sequence[float] | None = None,
) -> Selection:
    """Resolve names, suites and paths; engines as NAME or NAME:METHOD; steps in s for every scenario.

    Raises InputError with one line an error: unknown names, wrong files, steps that do not fit.
    """
    loaded = load_scenarios(scenarios)
    methods, unavailable = _methods(engines)
    faults = []
    for _, scenario in loaded:
        seen: set[int] = set()
        for step in dt_s or ():
            try:
                stride = steps_per_sample(scenario.scene.sample_interval_s, step)
            except ValueError as error:
                faults.append(f"{scenario.name}: {error}")
                continue
            if stride in seen:
                faults.append(f"{scenario.name}: the step of {step!r} s is asked for twice")
            seen.add(stride)
    if faults:
        raise InputError("\n".join(faults))
    return Selection(tuple(loaded), methods, unavailable, tuple(dt_s) if dt_s else None)


def _methods(asked: Sequence[str] | None) -> tuple[tuple[tuple[Adapter, Method], ...], dict[str, str]]:
    """Return the methods asked for, else all of every engine that is there, with why the others are not."""
    unavailable: dict[str, str] = {}
    methods: dict[tuple[str, str], tuple[Adapter, Method]] = {}
    faults = []
    for name in engine_names() if asked is None else asked:
        engine, colon, method = (part.strip() for part in name.partition(":"))
        try:
            adapter = get_adapter(engine)
        except UnavailableError as error:
            if asked:
                raise InputError(str(error)) from None
            unavailable[engine] = str(error)
            continue
        except InputError as error:
            faults.append(str(error))
            continue
        if colon and method not in adapter.methods:
            faults.append(f"{engine} has no method {method!r}; it has {', '.join(adapter.methods)}")
            continue
        for chosen in [method] if colon else adapter.methods:
            methods[engine, chosen] = (adapter, adapter.methods[chosen])
    if faults:
        raise InputError("\n".join(faults))
    return tuple(methods.values()), unavailable


class Progress(Protocol):
    """What is told of a run while it goes on."""

    def phase(self, what: str) -> None:
        """Something has begun: compiling, or the next scenario."""

    def case_done(self) -> None:
        """One more case has ended."""


class _Silence:
    def phase(self, what: str) -> None:
        pass

    def case_done(self) -> None:
        pass


def run(
    scenarios: Sequence[str | Path] = ("standard",),
    *,
    engines: Sequence[str] | None = None,
    dt_s: Sequence[float] | None = None,
    speed: bool = True,
) -> Run:
    """Measure scenarios x methods x steps and return the tables with the motions behind them.

    scenarios: built-in names, suites, paths of TOML files. engines: NAME or NAME:METHOD, all that can be
    imported by default. dt_s: the steps in s; by default each scenario's own, and more where an order
    needs them. speed: whether processor time is measured. Raises InputError for wrong input.
    """
    return run_selection(select(scenarios, engines, dt_s), speed=speed, progress=_Silence())


def run_selection(selection: Selection, *, speed: bool, progress: Progress) -> Run:
    """Run what was selected, scenario by scenario, method by method, coarse steps before fine ones."""
    created = datetime.now(UTC)
    run_id = f"{created:%Y%m%dT%H%M%SZ}-{secrets.token_hex(3)}"
    progress.phase("compiling the reference's kernels (once on a machine)")
    begin = time.perf_counter()
    compile_kernels(
        method.name
        for adapter, method in selection.methods
        if adapter.name == "reference" and method.control == "dt"
    )
    compiled = time.perf_counter()
    subjects: list[Subject] = []
    cases: list[CaseResult] = []
    method_rows: list[dict[str, Any]] = []
    for asked_as, scenario in selection.scenarios:
        progress.phase(scenario.name)
        subject = Subject.of(scenario, asked_as)
        subjects.append(subject)
        for adapter, method in selection.methods:
            studied = study(
                subject,
                adapter,
                method,
                sorted(selection.dt_s or scenario.steps, reverse=True),
                adaptive=selection.dt_s is None,
                speed=speed,
                case_done=progress.case_done,
            )
            cases += studied.cases
            method_rows += studied.method_rows
    seconds = {"compile_s": compiled - begin, "run_s": time.perf_counter() - compiled}
    return Run(
        run_id=run_id,
        results=as_table(({"run_id": run_id, **case.columns} for case in cases), RESULT_COLUMNS),
        methods=as_table(({"run_id": run_id, **row} for row in method_rows), METHOD_COLUMNS),
        manifest=_manifest(run_id, created, selection, cases, seconds, speed=speed),
        subjects=tuple(subjects),
        cases=tuple(cases),
    )


def truth(scenario: str | Path, at: Sequence[float]) -> Truth:
    """Return the true motion at the times given, in s, with its bounds.

    scenario: a built-in name or the path of a TOML file. Raises InputError where the scenario is wrong, or
    a time is negative or not finite.
    """
    scene = load_scenario(scenario).scene
    try:
        return solve_truth(scene, np.array(at, dtype=np.float64))
    except ValueError as error:
        raise InputError(str(error)) from None


def judge(trajectory: str | Path, scenario: str | Path) -> dict[str, Any]:
    """Return the measures of a trajectory that any program wrote (.csv or .npz), by column name.

    A measure whose quantities the file has not is left out. Raises InputError for wrong files.
    """
    return judge_file(Path(trajectory), load_scenario(scenario), str(scenario))


def _manifest(
    run_id: str,
    created: datetime,
    selection: Selection,
    cases: Sequence[CaseResult],
    seconds: dict[str, float],
    *,
    speed: bool,
) -> dict[str, Any]:
    """Return versions, machine and settings, as plain data."""
    engines: dict[str, Any] = {name: {"unavailable": why} for name, why in selection.unavailable.items()}
    for adapter, method in selection.methods:
        entry = engines.setdefault(adapter.name, {"version": adapter.version, "methods": {}})
        entry["methods"][method.name] = asdict(method)
    return {
        "run_id": run_id,
        "created": created.isoformat(timespec="seconds"),
        "bodycheck": version("bodycheck"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "libraries": {name: version(name) for name in ("numpy", "numba", "scipy", "pandas")},
        "engines": engines,
        "dt_s": selection.dt_s,
        "speed": speed,
        "outcomes": dict(Counter(case.columns["outcome"] for case in cases)),
        "scenarios": {s.name: s.model_dump(mode="json", exclude_none=True) for _, s in selection.scenarios},
        **seconds,
    }


def _cpu_model() -> str:
    """Return the processor's name as Linux gives it, else as Python does."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
