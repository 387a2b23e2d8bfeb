"""The pytest fixtures `bodycheck` and `bodycheck_gate`, and the parametrization of their tests."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cache
from glob import escape
from hashlib import sha256
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.engine_names import admit
from bodycheck.adapters.registry import registered
from bodycheck.adapters.step_function import Step, StepFunction
from bodycheck.reports.cache import Reuse
from bodycheck.reports.gates.gate import Gate, gate_of, measure_of, read_gates
from bodycheck.reports.gates.gate_output import failure_rows, line_of, note_failures, obtained
from bodycheck.reports.gates.verdict import GateCheck, GateResult, GateRow, check_gates, rows_of
from bodycheck.reports.measurement.verdicts import QuantityVerdict, most_severe
from bodycheck.reports.run_files.report_files import replace_pages
from bodycheck.reports.run_files.run_tables import FAILED_CASES, Run, study_key
from bodycheck.reports.run_files.tables import TABLES
from bodycheck.reports.run_files.writer import write_tables
from bodycheck.runs import runner
from bodycheck.runs.directory import write_run
from bodycheck.runs.gate_run import run_for_gates
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import NULL_PROGRESS
from bodycheck.runs.selection import select
from bodycheck.scenarios.library import load_scenarios

_MAX_ROWS = 20

Record: TypeAlias = Callable[[str], None]
"""Adds a line to the summary at the end of the session."""


@dataclass(frozen=True, eq=False)
class Measured:
    """The measures of a run: one case, or the cases of several steps, methods or scenarios.

    results: one row per case, with the columns of results.csv. methods: orders and verdicts. report: the
    report of the run, where --bodycheck-report keeps it.
    """

    run: Run
    record: Record
    cause: Exception | None = None
    report: Path | None = None

    @property
    def results(self) -> Any:
        """results.csv as a pandas table, one row per case."""
        return self.run.results

    @property
    def methods(self) -> Any:
        """methods.csv as a pandas table, one row per scenario, method and quantity."""
        return self.run.methods

    def __getitem__(self, measure: str) -> float | str:
        """Return the only value of a measure, named as in a gate.

        Raises AssertionError if it was not measured, InputError if it has several values or is unknown.
        """
        __tracebackhide__ = True
        row = self._only_row(measure)
        self.record(f"measured {_row_name(row)}: {measure} {obtained(GateCheck(row, passed=True))}")
        if row.obtained is None:
            raise AssertionError(f"{_row_name(row)}: {row.why}\n    {row.reproduce}") from self.cause
        return row.obtained

    def _only_row(self, measure: str) -> GateRow:
        try:
            measure_of(measure)
        except ValueError as error:
            raise InputError(str(error)) from None
        rows = rows_of(
            Gate.model_validate({"measure": measure, "reason": "it is read, not checked"}), self.run
        )
        if len(rows) != 1:
            raise InputError(
                f"{measure}: has {len(rows)} values; check() checks all of them, results lists them"
            )
        return rows[0]

    def check(self, measure: str, **bound: Any) -> None:
        """Assert that a measure meets its bound in every case of the run.

        measure: a column of results.csv, order.MEASURE, verdict, outcome, ..., as in a gate. bound: upper,
        lower, near with decades, or equals; floor. A measure that was not measured fails.
        """
        __tracebackhide__ = True
        table = {**self._common_names(), "measure": measure, "reason": "a check", **bound}
        (result,) = check_gates([gate_of(table, f"check({measure!r})")], self.run)
        self._assert(result)

    def _common_names(self) -> dict[str, str]:
        """Return the scenario, engine and method that all cases share, for a gate to name."""
        found = {
            key: {case.columns[key] for case in self.run.cases} for key in ("scenario", "engine", "method")
        }
        return {key: escape(names.pop()) for key, names in found.items() if len(names) == 1}

    def _assert(self, result: GateResult) -> None:
        __tracebackhide__ = True
        run = self.run
        if result.is_bad:
            from bodycheck.examine.explanation.explain import MAX_EXPLAINED, with_causes  # few checks fail

            note_failures(run, [result])
            run = with_causes(run, run.manifest[FAILED_CASES][:MAX_EXPLAINED])
            if self.report is not None:
                from bodycheck.reports.render.html import report_pages  # imported here: it needs Jinja

                write_tables(run, self.report.parent)
                replace_pages(report_pages(run), self.report)
        assert_passed(result, run, self.record, self.cause, self.report)


def _row_name(row: GateRow) -> str:
    return " ".join(filter(None, (row.scenario, f"{row.engine}:{row.method}", row.at)))


def assert_passed(
    result: GateResult,
    run: Run,
    record: Record,
    cause: Exception | None = None,
    report: Path | None = None,
) -> None:
    """Raise AssertionError, with one paragraph per failing row and the report, if a gate does not pass."""
    __tracebackhide__ = True
    if result.status == "passed":
        record(f"passed {line_of(result)}{_beside(result, run)}")
        return
    record(f"{result.status} {line_of(result)}")
    lines = [line_of(result)]
    rows = failure_rows([result])
    diagnoses = {study_key(row): row["diagnosis"] for row in run.rows("diagnoses")}
    for (_, *cells, command), check in zip(rows[:_MAX_ROWS], result.failed, strict=False):
        if len(result.checks) > 1:
            lines.append(" | ".join(filter(None, cells)))
        lines += [f"    {line}" for line in check.row.errors]
        if diagnosis := diagnoses.get(study_key(vars(check.row))):
            lines.append(f"    diagnosis: {diagnosis}")
        lines.append(f"    reproduce: {command}")
    if len(rows) > _MAX_ROWS:
        lines.append(f"and {len(rows) - _MAX_ROWS} more")
    if report is not None:
        lines.append(f"report: {report}")
        if run.cases:
            lines.append(f"explain: {shlex.join(['bodycheck', 'explain', str(report.parent)])}")
    elif run.cases:
        lines.append("explain: pytest --bodycheck-report DIR keeps the run for `bodycheck explain`")
    raise AssertionError("\n".join(lines)) from cause


def _beside(result: GateResult, run: Run) -> str:
    """Return the worst verdict against the methods of a passed check in a quantity that it does not check."""
    checked = {study_key(vars(check.row)) for check in result.checks}
    quantities = result.gate.target.quantity, result.gate.target.column
    others = (row for row in run.rows("methods") if row["quantity"] not in quantities)
    against = most_severe(QuantityVerdict.of(row) for row in others if study_key(row) in checked)
    return f"; but {against[0].text}" if against else ""


_KEYS = ("scenario", "engine", "method", "dt_s")
_LONGEST_NAME = 150


@dataclass(frozen=True, repr=False)
class Bench:
    """The fixture `bodycheck`; markers and options are the defaults for arguments left out of a call."""

    defaults: dict[str, Any]
    record: Record
    nodeid: str
    report_folder: Path | None = None

    def __repr__(self) -> str:
        return "<the fixture bodycheck>"

    @classmethod
    def of(cls, request: pytest.FixtureRequest) -> Bench:
        """Return the fixture of one test."""
        defaults = {**_marked_defaults(request.node), **getattr(request, "param", {})}
        return cls(defaults, _recorder(request), request.node.nodeid, _report_folder(request))

    def run(
        self,
        scenario: str | Path | None = None,
        *,
        engine: str | Adapter | None = None,
        method: str | None = None,
        dt_s: float | Sequence[float] | None = None,
        tolerance: float | None = None,
    ) -> Measured:
        """Run a scenario on an engine and return the measures, without CPU times.

        scenario: a name, a suite or the path of a TOML file. engine: a name, or an adapter object. method: a
        method of the engine [default: all]. dt_s: one or several step sizes in s [default: the scenario's,
        and more until an order can be fitted]. tolerance: the error tolerance of an adaptive method. Raises
        InputError for wrong input.
        """
        arguments = {"scenario": scenario, "engine": engine, "method": method, "dt_s": dt_s}
        requested = {**self.defaults, **{key: value for key, value in arguments.items() if value is not None}}
        for key in ("scenario", "engine"):
            if requested.get(key) is None:
                raise InputError(f"bodycheck.run: {key}= is required, in the call or in the marker")
        engine = requested["engine"]
        own = not isinstance(engine, str)
        if own and not hasattr(engine, "name"):
            raise InputError(
                f"{engine!r} is neither an adapter nor the name of an engine; pass a function to step()"
            )
        name = engine if isinstance(engine, str) else engine.name
        with _known(engine):
            measured = runner.run(
                [requested["scenario"]],
                engines=[name if requested.get("method") is None else f"{name}:{requested['method']}"],
                dt_s=_steps(requested.get("dt_s")),
                tolerances=None if tolerance is None else [tolerance],
                speed=False,
            )
        if own:
            measured = _repeated_by(measured, shlex.join(["pytest", self.nodeid]))
        report = None
        if self.report_folder is not None:
            report = write_run(measured, self.report_folder / measured.run_id)
            self.record(f"report {report}")
        return Measured(measured, self.record, report=report)

    def step(
        self,
        function: Step,
        scenario: str | Path | None = None,
        *,
        dt_s: float | Sequence[float] | None = None,
    ) -> Measured:
        """Step a scenario by a user's function and return the measures.

        function: called as function(state, dt) with a StepState and dt in s; returns the state dt later.
        scenario and dt_s as for run. An exception of the function becomes the cause of the failing check.
        """
        adapter = StepFunction(function)
        measured = self.run(scenario, engine=adapter, method=next(iter(adapter.methods)), dt_s=dt_s)
        return replace(measured, cause=adapter.fault)


def _known(engine: Any) -> AbstractContextManager[None]:
    return nullcontext() if isinstance(engine, str) else registered(engine)


def _steps(dt_s: float | Sequence[float] | None) -> Iterable[float] | None:
    return None if dt_s is None else np.atleast_1d(dt_s)


def _report_folder(request: pytest.FixtureRequest) -> Path | None:
    """Return DIR/TEST of --bodycheck-report; None without this option."""
    folder = request.config.getoption("--bodycheck-report")
    return None if folder is None else Path(folder).absolute() / _file_name(request.node.nodeid)


def _file_name(nodeid: str) -> str:
    """Return a folder name for a test; a digest distinguishes tests that differ only in other characters."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", nodeid).strip("-.")[-_LONGEST_NAME:]
    return f"{plain}-{sha256(nodeid.encode()).hexdigest()[:8]}"


def _repeated_by(run: Run, command: str) -> Run:
    """Return the run with the command that runs it again, such as a test."""
    cases = tuple(replace(case, columns={**case.columns, "reproduce": command}) for case in run.cases)
    again = {name: {"reproduce": command} for name, kind in TABLES.items() if "reproduce" in kind.columns}
    tables = {name: [{**row, **again.get(name, {})} for row in rows] for name, rows in run.tables.items()}
    return replace(run, cases=cases, tables=tables)


def _refuse(message: str) -> NoReturn:
    """Fail the collection of a file with this line and without pytest's stack frames."""
    pytest.fail(message, pytrace=False)


def _marked_defaults(node: pytest.Item) -> dict[str, Any]:
    """Return the arguments of all markers of a test; those of its function take precedence."""
    defaults: dict[str, Any] = {}
    for marker in node.iter_markers("bodycheck"):  # the closest first
        defaults = {**_marker_defaults(marker), **defaults}
    return defaults


def _marker_defaults(marker: pytest.Mark) -> dict[str, Any]:
    unknown = [*map(repr, marker.args), *(key for key in marker.kwargs if key not in _KEYS)]
    if unknown:
        known = ", ".join(f"{key}=" for key in _KEYS)
        _refuse(f"the marker bodycheck takes {known}, not {', '.join(unknown)}")
    return dict(marker.kwargs)


def _recorder(request: pytest.FixtureRequest) -> Record:
    return lambda line: request.node.user_properties.append(("bodycheck", line))


def parametrize_cases(metafunc: pytest.Metafunc) -> None:
    """Run a marked test once per scenario and method that an option names and its markers do not set."""
    defaults = _marked_defaults(metafunc.definition)
    suite = None if "scenario" in defaults else metafunc.config.getoption("--bodycheck-suite")
    engines = defaults.get("engine", metafunc.config.getoption("--bodycheck-engines"))
    try:
        scenarios = [{"scenario": name} for name in _scenarios(suite)] if suite else [{}]
        methods = _unset_methods(engines, defaults) if isinstance(engines, str) else [{}]
    except InputError as error:
        _refuse(f"{metafunc.definition.nodeid}: {error}")
    cases = [{**scenario, **method} for scenario in scenarios for method in methods]
    if cases != [{}]:
        names = ["-".join(case.values()) for case in cases]
        metafunc.parametrize("bodycheck", cases, ids=names, indirect=True)


@cache
def _scenarios(suite: str) -> list[str]:
    return [scenario_spec for scenario_spec, _ in load_scenarios(suite.split(","))]


def _unset_methods(engines: str, defaults: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the engines and methods that the markers of a test do not set.

    A marked method is run on each engine; a marked engine with a marked method leaves nothing open.
    """
    if "method" not in defaults:
        return [{"engine": engine, "method": method} for engine, method in _methods(engines)]
    if "engine" in defaults:
        return [{}]
    return [{"engine": engine} for engine in dict.fromkeys(engine for engine, _ in _methods(engines))]


@cache
def _methods(engines: str) -> list[tuple[str, str]]:
    names = engines.split(",")
    admit(names, allow_code=True)
    return [(engine.name, method.name) for engine, method in select((), names).methods]


@dataclass(frozen=True, eq=False)
class GateCase:
    """The fixture `bodycheck_gate`: one gate of a file, to check on a run of the scenarios."""

    gate: Gate
    run_gates: tuple[Gate, ...]
    scenarios: tuple[str, ...]
    reuse: Reuse
    report_folder: Path | None = None
    record: Record | None = None

    def within(self, request: pytest.FixtureRequest) -> GateCase:
        """Return a copy that records into one test's report."""
        return replace(self, record=_recorder(request))

    def check(self) -> None:
        """Assert that the gate passes; a gate that matched or measured nothing fails."""
        __tracebackhide__ = True
        assert self.record is not None
        run, report = _run_of(self.run_gates, self.scenarios, self.reuse, self.report_folder)
        (result,) = check_gates([self.gate], run)
        assert_passed(result, run, self.record, report=report)


@cache
def _run_of(
    gates: tuple[Gate, ...], scenarios: tuple[str, ...], reuse: Reuse, report_folder: Path | None
) -> tuple[Run, Path | None]:
    run = run_for_gates(
        gates, scenarios, Request(reuse_by_default=reuse), lambda _: nullcontext(NULL_PROGRESS)
    )
    if report_folder is None:
        return run, None
    return run, write_run(run, report_folder / run.run_id)


def parametrize_gates(metafunc: pytest.Metafunc) -> None:
    """Run a test once per gate of --bodycheck-gates."""
    file = metafunc.config.getoption("--bodycheck-gates")
    if file is None:
        _refuse(f"{metafunc.definition.nodeid}: bodycheck_gate needs --bodycheck-gates FILE")
    try:
        gates = read_gates(Path(file))
        allow_code = metafunc.config.getoption("--bodycheck-allow-code")
        admit((gate.engine for gate in gates), allow_code=allow_code, file=Path(file))
    except InputError as error:
        _refuse(str(error).replace("--allow-code", "--bodycheck-allow-code"))
    suite = metafunc.config.getoption("--bodycheck-suite") or "standard"
    scenarios = tuple(suite.split(","))
    # under pytest-xdist each process runs what its own gates need; otherwise one run serves all gates
    shared = hasattr(metafunc.config, "workerinput")
    reuse: Reuse = "everything" if metafunc.config.getoption("--bodycheck-reuse") else "truths"
    folder = metafunc.config.getoption("--bodycheck-report")
    report_folder = None if folder is None else Path(folder).absolute() / "gates"
    params = [GateCase(gate, (gate,) if shared else gates, scenarios, reuse, report_folder) for gate in gates]
    names = [f"{index}-{gate.scenario}-{gate.engine}-{gate.method}" for index, gate in enumerate(gates)]
    metafunc.parametrize("bodycheck_gate", params, ids=names, indirect=True)
