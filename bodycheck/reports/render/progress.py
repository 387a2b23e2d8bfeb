"""Show the progress of a run on the terminal."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text


@contextmanager
def watched(what: str) -> Iterator[None]:
    """Show a description and the elapsed time on standard error, if that is a terminal."""
    console = Console(stderr=True, highlight=False)
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        shown.add_task(what, total=None)
        yield


class LiveProgress:
    """A progress bar on standard error if that is a terminal, else one line per phase."""

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
        """Count one more measured speed; the total is the number of cases that ran."""
        if self._timed == 0:
            self._bar.reset(self._task, total=self._done)
        self._timed += 1
        self._bar.update(self._task, completed=self._timed)

    def phase(self, what: str) -> None:
        """Show the name of the phase that has begun."""
        self._bar.update(self._task, description=what)
        if not self._console.is_terminal:
            self._console.print(Text(what))

    def truth_begun(self, scenario: str) -> None:
        """Show the scenario whose truth is being solved, on a terminal only."""
        self._bar.update(self._task, description=f"solving the truth of {scenario}")

    def case_done(self) -> None:
        """Count one more case, from any thread; steps added during the run raise the total."""
        with self._lock:
            self._done += 1
            self._listed = max(self._listed, self._done)
            self._bar.update(self._task, completed=self._done, total=self._listed)
