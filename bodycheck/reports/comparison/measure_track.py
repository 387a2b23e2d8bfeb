"""Read one measure of one method from the tables of runs, and compare it between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from glob import escape

from bodycheck._util.errors import InputError
from bodycheck.reports.comparison.compare import compare
from bodycheck.reports.gates.gate import Gate, Measure, measure_of
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.gates.verdict import rows_of
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.reports.run_files.run_reader import Tables
from bodycheck.reports.run_files.run_tables import Run

_ABSOLUTE = "_abs"


def comparable(name: str) -> Measure:
    """Return the measure of that name; names are those of gates.

    Raises InputError if the measure is unknown, or if runs are not compared by it.
    """
    try:
        measure = measure_of(name)
    except ValueError as error:
        raise InputError(f"--measure {name}: {error}") from None
    if measure.is_speed:
        raise InputError(f"--measure {name}: cannot search by speed: it varies from run to run")
    in_results = measure.source == "results" and not measure.choices
    if in_results and name.removesuffix(_ABSOLUTE) not in MEASURES:
        raise InputError(f"--measure {name}: runs are not compared by it; see bodycheck list measures")
    return measure


@dataclass(frozen=True, eq=False)
class Finding:
    """The value of a measure in one run: a finite number or a word; None if there is none, and then why."""

    value: float | str | None
    why: str
    tables: Tables | None = None


@dataclass(frozen=True)
class OneMeasure:
    """One measure of one method on one scenario.

    fineness: the step or the tolerance; None if the measure covers all of them. thresholds: the sizes above
    which a change counts.
    """

    scenario: str
    engine: str
    method: str
    name: str
    control: str
    fineness: float | None
    thresholds: Thresholds = DEFAULT_THRESHOLDS

    def finding(self, tables: Tables) -> Finding:
        """Return the value of the measure in a run."""
        of_case = comparable(self.name).source == "results"
        gate = Gate(
            scenario=escape(self.scenario),
            engine=self.engine,
            method=self.method,
            dt_s=self.fineness if of_case and self.control == "dt" else None,
            tolerance=self.fineness if of_case and self.control == "tolerance" else None,
            measure=self.name,
            reason="requested",
        )
        for row in rows_of(gate, tables):
            return Finding(row.obtained, row.why, tables)
        # a scene that the method does not support is not run at the finer steps
        first = next(case.columns for case in tables.cases if case.columns["method"] == self.method)
        return Finding(None, f"{first['outcome']}: {first['message']}", tables)

    def differ(self, before: Finding, after: Finding) -> bool:
        """Whether two runs differ in this measure: words by equality, numbers as in `compare`.

        A change below the threshold is not a difference. Two missing values are equal; a missing value
        differs from any other.
        """
        a, b = before.value, after.value
        if isinstance(a, str) or isinstance(b, str) or a is None or b is None:
            return a != b
        assert before.tables is not None
        assert after.tables is not None
        return any(
            (change.scenario, change.engine, change.method) == (self.scenario, self.engine, self.method)
            and change.quantity in self._quantities_of
            and self._is_of(change.fineness)
            for change in compare(before.tables, after.tables, self.thresholds).of_status("worse", "improved")
        )

    @property
    def _quantities_of(self) -> tuple[str, ...]:
        """The quantities under which a comparison reports changes of this measure, if it is a number."""
        measure = comparable(self.name)
        if measure.quantity is not None:
            return (f"order of {measure.quantity}",)
        return (measure.column, measure.column.removesuffix(_ABSOLUTE))

    def _is_of(self, fineness: float | None) -> bool:
        return fineness is None or fineness == self.fineness


def under_one_name(run: Run, engine: str) -> Tables:
    """Return the tables of a run of one engine with the engine renamed, so that two versions share a name."""
    return Tables(
        run_id=run.run_id,
        results=run.results.assign(engine=engine),
        methods=run.methods.assign(engine=engine),
        stability=run.stability.assign(engine=engine),
        manifest=run.manifest,
        cases=tuple(replace(case, columns={**case.columns, "engine": engine}) for case in run.cases),
        probes=run.probes.assign(engine=engine),
        fingerprints=run.fingerprints.assign(engine=engine),
        laws=run.laws.assign(engine=engine),
    )
