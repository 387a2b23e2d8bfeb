"""Show the progress of a run on the terminal."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from types import TracebackType

from rich.console import Console
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task
from rich.text import Text

from bodycheck.reports.table_layout import shortened

_SPINNER_WIDTH = 2
_MAX_SILENCE_S = 30.0  # of a log


@contextmanager
def status_line(description: str, *, quiet: bool = False) -> Iterator[None]:
    """Show a description and the elapsed time on standard error: on a terminal, or every 30 s in a log."""
    with _bar(quiet=quiet) as bar, nullcontext() if quiet else _logged(bar):
        bar.add_task(description, total=None)
        yield


@contextmanager
def _logged(bar: Progress) -> Iterator[None]:
    """Print the line of a bar every 30 s if standard error is not a terminal, on which the bar is shown."""
    ended, line = threading.Event(), _Line(bar.console)

    def repeat() -> None:
        while not ended.wait(_MAX_SILENCE_S):
            for task in bar.tasks:
                bar.console.print(line.render(task))

    thread = threading.Thread(target=repeat, daemon=True)
    if not bar.console.is_terminal:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if thread.ident is not None:
            thread.join()


def _bar(*, quiet: bool = False) -> Progress:
    console = Console(stderr=True, highlight=False)
    disabled = quiet or not console.is_terminal
    columns = (SpinnerColumn(), _Line(console))
    return Progress(*columns, console=console, transient=True, disable=disabled)


class _Line(ProgressColumn):
    """The phase, its count, the elapsed and the remaining time, in one line of the terminal."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console

    def render(self, task: Task) -> Text:
        """Return the line; a narrow terminal shows the phase shortened and the times whole."""
        amount = "" if task.total is None else f" {task.completed:.0f}/{task.total:.0f}"
        unit, note = task.fields.get("unit", ""), task.fields.get("note", "")
        description = task.description
        if note and task.finished:  # nothing is left to be counted, but the work goes on
            description, amount, unit, note = f"after all{unit}: {note.strip(' ()')}", "", "", ""
        times = f", elapsed {_clock(task.elapsed)}"
        if task.total and task.elapsed and 1 < task.completed < task.total:  # the latest may not be typical
            times += f", remaining {_clock(task.elapsed * (task.total / task.completed - 1.0))}"
        room = self._console.width - _SPINNER_WIDTH - len(amount + unit + times)
        text = f"{description}{amount}{unit}{note}{times}"
        if len(text) > self._console.width - _SPINNER_WIDTH:
            text = f"{shortened(description, room)}{amount}{unit}{times}"
        return Text(text, no_wrap=True, overflow="ellipsis")


def _clock(seconds: float | None) -> str:
    """Return seconds as 1:05 or 1:02:05."""
    minutes, rest = divmod(int(seconds or 0.0), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class LiveProgress:
    """One line on standard error that is kept up to date if that is a terminal, else one per phase and 30 s.

    label: what the run is one of, such as a release; it precedes each phase, and a log has no phases then.
    """

    def __init__(self, cases_listed: int, label: str = "") -> None:
        self._bar = _bar()
        self._logs = not self._bar.console.is_terminal and not label
        self._label = f"{label}: " if label else ""
        self._logged = _logged(self._bar)
        self._task = self._bar.add_task(f"{self._label}starting the engines", total=None)
        self._lock = threading.Lock()
        self._listed, self._done, self._timed = cases_listed, 0, 0
        self._compiling = False

    def __enter__(self) -> LiveProgress:
        self._bar.start()
        self._logged.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._logged.__exit__(kind, error, trace)
        self._bar.stop()

    def phase(self, name: str) -> None:
        """Show the name of the phase that has begun."""
        self._show(name)

    def compiling(self, done: int, total: int) -> None:
        """Show how much is compiled; called only while something is, so that at least one more follows."""
        total = max(total, done + 1)
        if not self._compiling:
            self._compiling = True
            self._show("compiling", " (first run only)", total=total, unit=" kernels")
        self._bar.update(self._task, completed=done, total=total)

    def truth_started(self, scenario: str) -> None:
        """Show the scenario whose truth is being solved, on a terminal only."""
        self._bar.update(self._task, description=f"{self._label}solving the truth of {scenario}")

    def motions_started(self) -> None:
        """Show the number of cases that have ended, of those listed."""
        self._show("motions", total=self._listed, unit=" cases")

    def task_started(self, name: str) -> None:
        """Show what an engine began last, next to the number of cases."""
        self._bar.update(self._task, note=f" ({name})")

    def case_done(self) -> None:
        """Count one more case, from any thread; steps added during the run raise the total."""
        with self._lock:
            self._done += 1
            self._listed = max(self._listed, self._done)
            self._bar.update(self._task, completed=self._done, total=self._listed)

    def speeds_started(self) -> None:
        """Show the number of cases that were timed, of those that ran."""
        self._show("speeds, one case at a time", total=self._done, unit=" cases")

    def speed_measured(self) -> None:
        """Count one more measured speed."""
        self._timed += 1
        self._bar.update(self._task, completed=self._timed)

    def _show(self, name: str, note: str = "", *, total: int | None = None, unit: str = "") -> None:
        if self._logs:
            self._bar.console.print(Text(name + unit * bool(note) + note))
        self._bar.remove_task(self._task)  # a task cannot lose its total
        self._task = self._bar.add_task(f"{self._label}{name}", total=total, note=note, unit=unit)
