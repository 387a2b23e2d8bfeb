"""The worst that a run found, each with the command that shows it again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bodycheck.reports.findings import Findings, key_of
from bodycheck.reports.keeping import ladders_of
from bodycheck.reports.summary import faults_of, is_lower, summary_cells, theory
from bodycheck.reports.wording import count, names, number, setting

_WORST_FIRST = (
    "invalid",
    "failed",
    "timeout",
    "unstable",
    "does-not-converge",
    "off",
    "plateau",
    "lower-order",
)


@dataclass(frozen=True)
class Offender:
    """What is wrong with one method on one scenario, and the command of a case that shows it.

    error: the least orientation error in rad of a method that does not converge; None else.
    """

    kind: str
    scenario: str
    method: str
    text: str
    reproduce: str
    error: float | None = None


def offenders(run: Findings) -> list[Offender]:
    """Return all that is wrong, the worst first: what broke, then what does not converge, by its error."""
    found = [*_broken(run), *_wrong(run)]
    return sorted(found, key=lambda one: (_WORST_FIRST.index(one.kind), -(one.error or 0.0)))


def _broken(run: Findings) -> Iterator[Offender]:
    commands = {
        (case.columns["scenario"], key_of(case.columns), case.columns["outcome"], case.setting.fineness): case
        for case in run.cases
    }
    for fault in faults_of(run.cases):
        first = commands[fault.scenario, fault.key, fault.outcome, fault.steps[0]]
        cases = count(len(fault.steps), "case")
        text = f"{fault.outcome} in {cases}: {fault.message}"
        yield Offender(fault.outcome, fault.scenario, ":".join(fault.key), text, first.columns["reproduce"])


def _wrong(run: Findings) -> Iterator[Offender]:
    ladders = ladders_of(run.cases)
    for scenario, methods in summary_cells(run).items():
        for key, cell in methods.items():
            finest = next((case for case in ladders[scenario, key] if case.ok), None)
            if finest is None:
                continue
            about = scenario, ":".join(key)
            reproduce, error = finest.columns["reproduce"], finest.columns["orientation_error_rad"]
            if cell.state in ("does-not-converge", "off"):
                at = setting(finest.columns["control"], finest.setting.fineness)
                text = f"does not converge: {number(error, 3)} rad, {at}"
                yield Offender(cell.state, *about, text, reproduce, error)
            elif cell.plateaus:
                text = f"{names(cell.plateaus)} do not shrink with the step"
                yield Offender("plateau", *about, text, reproduce)
            elif is_lower(run, key, cell):
                text = f"order {number(cell.order, 3)}, in theory {theory(run, key)}"
                yield Offender("lower-order", *about, text, reproduce)
