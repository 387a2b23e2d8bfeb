"""What the pytest fixtures do: run, hold a gate to what was measured, and say what failed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cache
from glob import escape
from pathlib import Path
from typing import Any, TypeAlias

import pytest

from bodycheck import runner
from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.registry import registered
from bodycheck.adapters.step_function import Step, StepFunction
from bodycheck.errors import InputError
from bodycheck.gate_run import run_for_gates
from bodycheck.manner import Manner
from bodycheck.progress import SILENCE
from bodycheck.reports.gates.gate import Gate, gate_of, read_gates
from bodycheck.reports.gates.measure import measure_of
from bodycheck.reports.gates.rows import Row, rows_of
from bodycheck.reports.gates.text import failure_rows, line_of, obtained
from bodycheck.reports.gates.verdict import Check, GateResult, held
from bodycheck.reports.run import Run
from bodycheck.scenarios.library import load_scenarios
from bodycheck.selection import select

_KEYS = ("scenario", "engine", "method", "dt_s")
_MOST_ROWS = 20

Record: TypeAlias = Callable[[str], None]
"""How a line comes into the summary at the end of the session."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What a run measured: one case, or the cases of several steps, methods or scenarios.

    results: one row a case, the columns of results.csv. methods: orders and verdicts.
    """

    run: Run
    record: Record
    rerun: str | None = None
    cause: Exception | None = None

    @property
    def results(self) -> Any:
        """One row a case, as results.csv has them: a pandas table."""
        return self.run.results

    @property
    def methods(self) -> Any:
        """One row a scenario, method and quantity, as methods.csv has them: a pandas table."""
        return self.run.methods

    def __getitem__(self, measure: str) -> float | str:
        """Return the one value of a measure, by the name that a gate has for it.

        Raises AssertionError where it was not measured, InputError where there are several, or where there is
        no such measure.
        """
        __tracebackhide__ = True
        row = self._only_row(measure)
        self.record(f"measured {_who(row)}: {measure} {obtained(Check(row, passed=True))}")
        if row.obtained is None:
            raise AssertionError(f"{_who(row)}: {row.why}\n    {self._command(row)}") from self.cause
        return row.obtained

    def _only_row(self, measure: str) -> Row:
        try:
            measure_of(measure)
        except ValueError as error:
            raise InputError(str(error)) from None
        rows = rows_of(Gate.model_validate({"measure": measure, "reason": "it is read, not held"}), self.run)
        if len(rows) != 1:
            raise InputError(
                f"{measure}: there are {len(rows)} of it; check() holds them all, results has them"
            )
        return rows[0]

    def check(self, measure: str, **bound: Any) -> None:
        """Assert that a measure keeps its bound in every case of the run.

        measure: a column of results.csv, order.MEASURE, verdict, outcome, ..., as in a gate. bound: upper,
        lower, near with decades, or equals; floor. What was not measured does not pass.
        """
        __tracebackhide__ = True
        told = {**self._same_in_all(), "measure": measure, "reason": "a check", **bound}
        (result,) = held([gate_of(told, f"check({measure!r})")], self.run)
        self._assert(result)

    def _same_in_all(self) -> dict[str, str]:
        """Return the scenario, engine and method where all cases share it, for a gate to name."""
        found = {key: {case.columns[key] for case in self.run.cases} for key in _KEYS[:3]}
        return {key: escape(names.pop()) for key, names in found.items() if len(names) == 1}

    def _assert(self, result: GateResult) -> None:
        __tracebackhide__ = True
        checks = tuple(
            replace(check, row=replace(check.row, reproduce=self._command(check.row)))
            for check in result.checks
        )
        _assert_passed(replace(result, checks=checks), self.record, self.cause)

    def _command(self, row: Row) -> str:
        return self.rerun or row.reproduce


def _who(row: Row) -> str:
    return " ".join(filter(None, (row.scenario, f"{row.engine}:{row.method}", row.at)))


def _assert_passed(result: GateResult, record: Record, cause: Exception | None = None) -> None:
    """Raise AssertionError, with one paragraph a row, where a gate does not hold."""
    __tracebackhide__ = True
    record(f"{result.status} {line_of(result)}")
    if result.status == "passed":
        return
    lines = [line_of(result)]
    rows = failure_rows([result])
    for _, *cells, command in rows[:_MOST_ROWS]:
        lines += [" | ".join(filter(None, cells)), f"    {command}"]
    if len(rows) > _MOST_ROWS:
        lines.append(f"and {len(rows) - _MOST_ROWS} more")
    raise AssertionError("\n".join(lines)) from cause


@dataclass(frozen=True)
class Bench:
    """The fixture `bodycheck`. What a marker or an option says stands for what a call does not say."""

    said: dict[str, Any]
    record: Record
    nodeid: str

    @classmethod
    def of(cls, request: pytest.FixtureRequest) -> Bench:
        """Return the bench of one test."""
        marker = request.node.get_closest_marker("bodycheck")
        said = {**(_said(marker) if marker else {}), **getattr(request, "param", {})}
        return cls(said, _recorder(request), request.node.nodeid)

    def run(
        self,
        scenario: str | Path | None = None,
        *,
        engine: str | Adapter | None = None,
        method: str | None = None,
        dt_s: float | Sequence[float] | None = None,
        tolerance: float | None = None,
    ) -> Measured:
        """Run a scenario through an engine and return what was measured, processor time excepted.

        scenario: a name, a suite or the path of a TOML file. engine: a name, or an adapter of your own.
        method: one of it, all unless told. dt_s: one step or several, in s; the scenario's own, and more
        until an order shows, unless told. tolerance: of a method that is told one. Raises InputError for
        wrong input.
        """
        told = {"scenario": scenario, "engine": engine, "method": method, "dt_s": dt_s}
        asked = {**self.said, **{key: value for key, value in told.items() if value is not None}}
        for key in ("scenario", "engine"):
            if asked.get(key) is None:
                raise InputError(f"bodycheck.run: needs {key}=, here or in the marker")
        engine = asked["engine"]
        own = not isinstance(engine, str)
        if own and not hasattr(engine, "name"):
            raise InputError(f"{engine!r} is no adapter and no name of an engine; a function goes to step()")
        name = engine if isinstance(engine, str) else engine.name
        with _known(engine):
            found = runner.run(
                [asked["scenario"]],
                engines=[name if asked.get("method") is None else f"{name}:{asked['method']}"],
                dt_s=_steps(asked.get("dt_s")),
                tolerances=None if tolerance is None else [tolerance],
                speed=False,
            )
        return Measured(found, self.record, f"pytest '{self.nodeid}'" if own else None)

    def step(
        self,
        function: Step,
        scenario: str | Path | None = None,
        *,
        dt_s: float | Sequence[float] | None = None,
    ) -> Measured:
        """Step a scenario by a function of your own and return what was measured.

        function: is given a StepState and dt in s, and gives back the state dt later. scenario and dt_s as
        for run. What the function raises is the cause of the check that fails.
        """
        adapter = StepFunction(function)
        found = self.run(scenario, engine=adapter, method=next(iter(adapter.methods)), dt_s=dt_s)
        return replace(found, cause=adapter.fault)


def _known(engine: Any) -> AbstractContextManager[None]:
    return nullcontext() if isinstance(engine, str) else registered(engine)


def _steps(dt_s: float | Sequence[float] | None) -> Sequence[float] | None:
    return [dt_s] if isinstance(dt_s, int | float) else dt_s


def _said(marker: pytest.Mark) -> dict[str, Any]:
    unknown = [*map(repr, marker.args), *(key for key in marker.kwargs if key not in _KEYS)]
    if unknown:
        raise pytest.UsageError(
            f"the marker bodycheck takes {', '.join(f'{key}=' for key in _KEYS)}, not {', '.join(unknown)}"
        )
    return dict(marker.kwargs)


def _recorder(request: pytest.FixtureRequest) -> Record:
    return lambda line: request.node.user_properties.append(("bodycheck", line))


def parametrize_cases(metafunc: pytest.Metafunc) -> None:
    """Run a marked test once for each scenario and method that its marker leaves open and an option names."""
    marker = metafunc.definition.get_closest_marker("bodycheck")
    assert marker is not None
    said = _said(marker)
    suite = None if "scenario" in said else metafunc.config.getoption("--bodycheck-suite")
    engines = said.get("engine", metafunc.config.getoption("--bodycheck-engines"))
    try:
        scenarios = [{"scenario": name} for name in _scenarios(suite)] if suite else [{}]
        has_methods = isinstance(engines, str) and "method" not in said
        methods = [{"engine": e, "method": m} for e, m in _methods(engines)] if has_methods else [{}]
    except InputError as error:
        raise pytest.UsageError(f"{metafunc.definition.nodeid}: {error}") from None
    cases = [{**scenario, **method} for scenario in scenarios for method in methods]
    if cases != [{}]:
        names = ["-".join(case.values()) for case in cases]
        metafunc.parametrize("bodycheck", cases, ids=names, indirect=True)


@cache
def _scenarios(suite: str) -> list[str]:
    return [asked_as for asked_as, _ in load_scenarios(suite.split(","))]


@cache
def _methods(engines: str) -> list[tuple[str, str]]:
    return [(engine.name, method.name) for engine, method in select((), engines.split(",")).methods]


@dataclass(frozen=True, eq=False)
class HeldGate:
    """The fixture `bodycheck_gate`: one gate of a file, to be held by a run of the scenarios."""

    gate: Gate
    beside: tuple[Gate, ...]
    scenarios: tuple[str, ...]
    record: Record | None = None

    def within(self, request: pytest.FixtureRequest) -> HeldGate:
        """Return the same for one test."""
        return replace(self, record=_recorder(request))

    def check(self) -> None:
        """Assert that the gate holds; what matched nothing or measured nothing does not."""
        __tracebackhide__ = True
        assert self.record is not None
        (result,) = held([self.gate], _run_of(self.beside, self.scenarios))
        _assert_passed(result, self.record)


@cache
def _run_of(gates: tuple[Gate, ...], scenarios: tuple[str, ...]) -> Run:
    return run_for_gates(gates, scenarios, Manner(), lambda _: nullcontext(SILENCE))


def parametrize_gates(metafunc: pytest.Metafunc) -> None:
    """Run a test once for each gate of --bodycheck-tolerances."""
    file = metafunc.config.getoption("--bodycheck-tolerances")
    if file is None:
        raise pytest.UsageError(
            f"{metafunc.definition.nodeid}: bodycheck_gate needs --bodycheck-tolerances FILE"
        )
    try:
        gates = read_gates(Path(file))
    except InputError as error:
        raise pytest.UsageError(str(error)) from None
    suite = metafunc.config.getoption("--bodycheck-suite") or "standard"
    scenarios = tuple(suite.split(","))
    # side by side, each process runs what its own gates need; alone, it runs all of it at once
    shared = hasattr(metafunc.config, "workerinput")
    params = [HeldGate(gate, (gate,) if shared else gates, scenarios) for gate in gates]
    names = [f"{place}-{gate.scenario}-{gate.engine}-{gate.method}" for place, gate in enumerate(gates)]
    metafunc.parametrize("bodycheck_gate", params, ids=names, indirect=True)
