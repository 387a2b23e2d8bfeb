"""The result of a fixture's run: values to read, bounds to check, and messages for failures."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path
from typing import Any, TypeAlias

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.gate import Gate, gate_of, measure_of
from bodycheck.reports.gates.gate_output import failure_rows, line_of, obtained
from bodycheck.reports.gates.verdict import Check, GateResult, Row, check_gates, rows_of
from bodycheck.reports.run_files.run_tables import Run

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
    rerun: str | None = None
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
        self.record(f"measured {_row_name(row)}: {measure} {obtained(Check(row, passed=True))}")
        if row.obtained is None:
            raise AssertionError(f"{_row_name(row)}: {row.why}\n    {self._command(row)}") from self.cause
        return row.obtained

    def _only_row(self, measure: str) -> Row:
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
        checks = tuple(
            replace(check, row=replace(check.row, reproduce=self._command(check.row)))
            for check in result.checks
        )
        assert_passed(replace(result, checks=checks), self.run, self.record, self.cause, self.report)

    def _command(self, row: Row) -> str:
        return self.rerun or row.reproduce


def _key(row: Mapping[Any, Any]) -> tuple[str, str, str]:
    return row["scenario"], row["engine"], row["method"]


def _row_name(row: Row) -> str:
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
    record(f"{result.status} {line_of(result)}")
    if result.status == "passed":
        return
    lines = [line_of(result)]
    rows = failure_rows([result])
    diagnoses = {_key(row): row["diagnosis"] for row in run.diagnoses.to_dict("records")}
    for (_, *cells, command), check in zip(rows[:_MAX_ROWS], result.failed, strict=False):
        if len(result.checks) > 1:
            lines.append(" | ".join(filter(None, cells)))
        lines += [f"    {line}" for line in check.row.errors]
        if diagnosis := diagnoses.get(_key(vars(check.row))):
            lines.append(f"    diagnosis: {diagnosis}")
        lines.append(f"    reproduce: {command}")
    if len(rows) > _MAX_ROWS:
        lines.append(f"and {len(rows) - _MAX_ROWS} more")
    if report is not None:
        lines += [f"report: {report}", f"explain: bodycheck explain {shlex.quote(str(report.parent))}"]
    raise AssertionError("\n".join(lines)) from cause
