"""What a run shows while it goes on."""

from __future__ import annotations

import io
import re
import time
from dataclasses import replace
from pathlib import Path

import pytest

from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.render.progress import LiveProgress
from bodycheck.reports.render.terminal import print_summary
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import Run


class Terminal(io.StringIO):
    """A terminal that remembers what it was shown."""

    def isatty(self) -> bool:
        """Say yes."""
        return True


def test_a_terminal_is_shown_how_long_a_run_will_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Cases done of those listed, and a time left once two have ended."""
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with LiveProgress(100) as progress:
        progress.phase("motions")
        for _ in range(3):
            progress.case_done()
            time.sleep(0.02)
        progress._bar.refresh()
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", terminal.getvalue())
    assert re.search(r"motions .*3/100 cases \d:\d\d:\d\d left \d:\d\d:\d\d", shown)


def test_a_log_is_told_each_phase_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Where standard error is no terminal there is no bar."""
    with LiveProgress(100) as progress:
        progress.phase("motions")
        progress.case_done()
    assert capsys.readouterr().err == "motions\n"


@pytest.fixture(scope="module")
def run(stored_run: Path) -> Run:
    """Return a run in which one case failed."""
    return read_run(stored_run, cache=Cache.default())


def summary(run: Run, monkeypatch: pytest.MonkeyPatch, output: io.StringIO, columns: str = "200") -> str:
    """Return what is printed of a run at its end."""
    monkeypatch.setattr("sys.stdout", output)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", columns)
    print_summary(run)
    return output.getvalue()


def test_the_summary_has_each_method_and_the_worst_with_its_command(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line a method; what failed stands below with how often, why, and the command to see it again."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    shown = summary(run, monkeypatch, io.StringIO()).splitlines()
    assert shown[0].startswith(f"{len(run.cases)} cases in ")
    for method in ("reference:m1", "reference:rk4", "reference:exact", "reference:taylor", "failing:m1"):
        assert sum(line.startswith(f"{method} ") and " rad in " in line for line in shown) == 1
    place = shown.index("Worst result of each method") + 1
    assert shown[place].startswith("failing:m1: failed in 1 case: RuntimeError")
    assert shown[place].endswith(" in forced, and a mesh")
    assert shown[place + 1].strip() == next(
        case.columns["reproduce"] for case in run.cases if case.columns["outcome"] == "failed"
    )


@pytest.mark.slow
@pytest.mark.parametrize("quiet", [True, False])
def test_colour_is_for_terminals_that_want_it(quiet: bool, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal has colour, but not with NO_COLOR; a pipe has none, and whole lines."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    if quiet:
        monkeypatch.setenv("NO_COLOR", "1")
    colour = re.compile(r"\x1b\[[0-9;]*3[0-7]m")
    assert bool(colour.search(summary(run, monkeypatch, Terminal()))) is not quiet
    piped = summary(run, monkeypatch, io.StringIO(), columns="20")
    assert "\x1b" not in piped
    assert any(re.match(r"reference:m1 .* rad in .*converges", line) for line in piped.splitlines())


@pytest.mark.slow
def test_every_faulty_method_has_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often one is invalid, it does not push the others out; what more there is of it is counted."""
    failed = next(case for case in run.cases if case.columns["outcome"] == "failed")
    more = [
        replace(failed, columns={**failed.columns, "outcome": outcome, "message": f"{k}"})
        for k in range(12)
        for outcome in ("timeout", "invalid")
    ]
    shown = summary(replace(run, cases=(*run.cases, *more)), monkeypatch, io.StringIO()).splitlines()
    (line,) = [line for line in shown if line.startswith("failing:m1: ")]
    assert line.startswith("failing:m1: invalid in 1 case: ")
    assert line.endswith("; 2 more findings")


def test_speeds_are_counted_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bar of the speeds starts anew, and is full when as many were looked at as there are cases."""
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with LiveProgress(2) as progress:
        for _ in range(3):
            progress.case_done()
        progress.phase("speeds")
        for _ in range(3):
            progress.speed_measured()
        progress._bar.refresh()
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", terminal.getvalue())
    assert re.search(r"speeds .*3/3 cases", shown)
