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
from rich.table import Table
from rich.text import Text

from bodycheck.adapters.contract import Engine
from bodycheck.adapters.host import announced
from bodycheck.adapters.registry import engine_names
from bodycheck.reports.tables import ABSOLUTE, MEASURES
from bodycheck.scenarios.library import scenario_summaries, suites

if TYPE_CHECKING:
    from bodycheck.reports.run import Run

_VERDICT_STYLES = {
    "converges": "green",
    "at-floor": "green",
    "pre-asymptotic": "yellow",
    "too-few-points": "yellow",
    "does-not-converge": "red",
    "unstable": "red",
}


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
    """Print how the cases ended, what was noted or failed, and the order of each method on each scenario."""
    console = Console(highlight=False)
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in run.manifest["outcomes"].items())
    seconds = run.manifest["run_s"]
    console.print(
        f"{len(run.cases)} cases in {seconds:.0f} s (compiling {run.manifest['compile_s']:.0f} s): {outcomes}"
    )
    for engine in run.manifest["engines"].values():
        if "unavailable" in engine:
            console.print(Text(f"not measured: {engine['unavailable']}", style="yellow"))
    for scenario in (subject.scenario for subject in run.subjects):
        for note in scenario.body.notes:
            console.print(Text(f"{scenario.name}: {note}", style="yellow"))
    for case in run.cases:
        if case.columns["outcome"] in ("failed", "invalid", "timeout"):
            line = f"{case.columns['outcome']}: {case.columns['reproduce']}: {case.columns['message']}"
            console.print(Text(line, style="red"))
    console.print(_order_table(run))


def _order_table(run: Run) -> Table:
    """Return one row a method: the orders of orientation seen over the scenarios, and the verdicts."""
    rows = run.methods[run.methods["quantity"] == "orientation_error_rad"]
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("engine:method", no_wrap=True)
    table.add_column("order of orientation", justify="right", no_wrap=True)
    table.add_column("scenarios")
    for (engine, method), group in rows.groupby(["engine", "method"], sort=False):
        orders = group["order"].dropna()
        seen = f"{orders.median():.2f} ({orders.min():.2f} to {orders.max():.2f})" if len(orders) else "-"
        counts = Text(", ").join(
            Text(f"{verdict} {count}", style=_VERDICT_STYLES.get(str(verdict), ""))
            for verdict, count in group["verdict"].value_counts().items()
        )
        table.add_row(Text(f"{engine}:{method}"), seen, counts)
    return table


def print_catalogue(what: str) -> None:
    """Print one line an entry: the name, then what it is."""
    console = Console(highlight=False, soft_wrap=True)
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
        console.print(Text(f"{name:{width}}  {text}"))


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
