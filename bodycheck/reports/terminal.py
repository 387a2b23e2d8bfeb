"""What a run says on the terminal: live progress, a summary at the end, and the catalogues of `list`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from bodycheck.adapters.contract import Engine
from bodycheck.adapters.host import announced
from bodycheck.adapters.registry import engine_names
from bodycheck.reports.console import console, print_columns
from bodycheck.reports.offenders import offenders
from bodycheck.reports.overview import Overview, overviews
from bodycheck.reports.states import STATES
from bodycheck.reports.summary import summary_cells
from bodycheck.reports.tables import ABSOLUTE, MEASURES
from bodycheck.scenarios.library import scenario_summaries, suites

if TYPE_CHECKING:
    from bodycheck.reports.run import Run

_TINT_STYLES = {"good": "green", "floor": "green", "open": "yellow", "bad": "red", "fault": "red", "none": ""}
_MOST_OFFENDERS = 10


class LiveProgress:
    """A bar on standard error where that is a terminal, else one line a scenario."""

    def __init__(self, cases_listed: int) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("cases"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("starting", total=cases_listed)
        self._lock = threading.Lock()
        self._listed, self._done, self._timed = cases_listed, 0, 0

    def __enter__(self) -> LiveProgress:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def speed_measured(self) -> None:
        """Count one more speed; as many are due as there were motions."""
        if self._timed == 0:
            self._bar.reset(self._task, total=self._done)
        self._timed += 1
        self._bar.update(self._task, completed=self._timed)

    def phase(self, what: str) -> None:
        """Name the phase that has begun."""
        self._bar.update(self._task, description=what)
        if not self._console.is_terminal:
            self._console.print(Text(what))

    def case_done(self) -> None:
        """Count one more case, from any thread; steps that were added on the way raise the total."""
        with self._lock:
            self._done += 1
        self._listed = max(self._listed, self._done)
        self._bar.update(self._task, completed=self._done, total=self._listed)


def print_summary(run: Run) -> None:
    """Print how the cases ended, one line a method, and the worst that was found with its commands."""
    out = console()
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in run.manifest["outcomes"].items())
    seconds = run.manifest["run_s"]
    compiling = run.manifest["compile_s"]
    out.print(f"{len(run.cases)} cases in {seconds:.0f} s (compiling {compiling:.0f} s): {outcomes}")
    for engine in run.manifest["engines"].values():
        if "unavailable" in engine:
            out.print(Text(f"not measured: {engine['unavailable']}", style="yellow"))
    for scenario in (subject.scenario for subject in run.subjects):
        for note in scenario.body.notes:
            out.print(Text(f"{scenario.name}: {note}", style="yellow"))
    rows = [
        (one.method, one.order, one.largest_error, _verdicts(one)) for one in overviews(summary_cells(run))
    ]
    heads = ("engine:method", "order of orientation", "largest error", "scenarios")
    print_columns(out, heads, rows, right=heads[1:2])
    worst = offenders(run)
    if worst:
        out.print(Text("\nThe worst", style="bold"))
    for one in worst[:_MOST_OFFENDERS]:
        out.print(Text(f"{one.method} in {one.scenario}: {one.text}", style="red"))
        out.print(Text(f"    {one.reproduce}"), soft_wrap=True)
    if len(worst) > _MOST_OFFENDERS:
        out.print(f"and {len(worst) - _MOST_OFFENDERS} more, in the report")


def _verdicts(overview: Overview) -> Text:
    """Return how many scenarios came to each verdict, each in its colour."""
    words = (
        Text(f"{STATES[state].word} {amount}", style=_TINT_STYLES[STATES[state].tint])
        for state, amount in overview.states.items()
    )
    return Text(", ").join(words)


def print_catalogue(what: str) -> None:
    """Print one line an entry: the name, then what it is."""
    out = Console(highlight=False, soft_wrap=True)
    catalogues: dict[str, Callable[[], list[tuple[str, str]]]] = {
        "scenarios": lambda: list(scenario_summaries().items()),
        "suites": lambda: [(name, ", ".join(members)) for name, members in suites().items()],
        "engines": _engine_rows,
        "methods": _method_rows,
        "measures": _measure_rows,
    }
    rows = catalogues[what]()
    width = max(len(name) for name, _ in rows)
    for name, text in rows:
        out.print(Text(f"{name:{width}}  {text}"))


def _measure_rows() -> list[tuple[str, str]]:
    units = {name: f"; as {name}_abs in {unit}" for name, unit in ABSOLUTE.items()}
    return [(name, text + units.get(name, "")) for name, text in MEASURES.items()]


def _engine_rows() -> list[tuple[str, str]]:
    return [
        (name, engine.version if isinstance(engine, Engine) else f"not there: {engine}")
        for name, engine in announced(engine_names()).items()
    ]


def _method_rows() -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    apart: list[tuple[str, str]] = []
    for name, engine in announced(engine_names()).items():
        for method in engine.methods.values() if isinstance(engine, Engine) else ():
            order = "" if method.order is None else f"; order {method.order}, torque {method.torque}"
            if method.lasting != method.torque:
                order += f", varying loads {method.lasting}"
            only = "; run only when asked for by name" if method.on_request else ""
            row = (f"{name}:{method.name}", f"{method.formula}{order}; keeps {method.keeps}{only}")
            (apart if method.on_request else rows).append(row)
    return rows + apart
