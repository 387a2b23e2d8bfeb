"""Progress of a run on the terminal, and its summary."""

from __future__ import annotations

import io
import re
import time
from dataclasses import replace
from pathlib import Path

import pytest

from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.document import print_document
from bodycheck.reports.render import progress as progress_module
from bodycheck.reports.render.progress import LiveProgress, status_line
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.summary.sentences import run_document


class Terminal(io.StringIO):
    """A terminal that records its output."""

    def isatty(self) -> bool:
        """Return True."""
        return True


def terminal_of(monkeypatch: pytest.MonkeyPatch, columns: int = 80) -> Terminal:
    """Return a terminal as standard error; called in the test, because pytest replaces it after setup."""
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(columns))
    return terminal


def last_line(terminal: Terminal, progress: LiveProgress) -> str:
    """Return the line that a terminal shows now."""
    progress._bar.refresh()
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", terminal.getvalue()).split("\r")
    return [line.strip() for line in lines if line.strip()][-1]


def test_a_terminal_shows_the_cases_and_both_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line has the cases done and listed, and after two cases the remaining time, each with its label."""
    terminal = terminal_of(monkeypatch)
    with LiveProgress(100) as progress:
        progress.motions_started()
        for _ in range(3):
            progress.case_done()
            time.sleep(0.02)
        shown = last_line(terminal, progress)
    assert re.fullmatch(r". motions 3/100 cases, elapsed \d:\d\d, remaining \d:\d\d", shown)


def test_compiling_is_shown_with_how_much_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line also states that only the first run compiles, and for how long."""
    terminal = terminal_of(monkeypatch)
    with LiveProgress(100) as progress:
        progress.compiling(3, 86)
        shown = last_line(terminal, progress)
    assert re.search(r"compiling 3/86 kernels \(first run only\), elapsed \d:\d\d", shown)


def test_a_total_is_reached_only_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A compilation that goes on has at least one more kernel, whatever was expected."""
    terminal = terminal_of(monkeypatch)
    with LiveProgress(100) as progress:
        progress.compiling(168, 168)
        assert " 168/169 kernels" in last_line(terminal, progress)


def test_what_goes_on_after_the_last_case_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The methods are examined then, which no count shows."""
    terminal = terminal_of(monkeypatch)
    with LiveProgress(2) as progress:
        progress.motions_started()
        progress.task_started("examining mujoco:rk4")
        progress.case_done()
        assert "motions 1/2 cases (examining mujoco:rk4)" in last_line(terminal, progress)
        progress.case_done()
        assert "after all cases: examining mujoco:rk4, elapsed" in last_line(terminal, progress)


@pytest.mark.parametrize("columns", [30, 40, 60])
def test_a_narrow_terminal_shows_the_counts_and_times_whole(
    columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the description is shortened so that the line fits."""
    terminal = terminal_of(monkeypatch, columns)
    with LiveProgress(100) as progress:
        progress.compiling(3, 10)
        shown = last_line(terminal, progress)
    assert len(shown) <= columns
    assert re.search(r" 3/10 kernels, elapsed \d:\d\d", shown)


def test_a_log_has_each_phase_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    """If standard error is not a terminal, a line about compiling appears only if something is compiled."""
    with LiveProgress(100) as progress:
        progress.phase("solving the truths")
        progress.motions_started()
        progress.case_done()
    assert capsys.readouterr().err == "solving the truths\nmotions\n"
    with LiveProgress(100) as progress:
        progress.compiling(0, 30)
        progress.compiling(1, 30)
    assert capsys.readouterr().err == "compiling kernels (first run only)\n"
    with LiveProgress(100, label="mujoco==4.0.0") as progress:
        progress.phase("solving the truths")
    assert capsys.readouterr().err == ""


def test_a_log_is_never_silent_for_long(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It repeats the count, what runs and the elapsed time, of runs and of other long commands."""
    monkeypatch.setattr(progress_module, "_MAX_SILENCE_S", 0.01)
    lines = iter(lambda: (time.sleep(0.01), capsys.readouterr().err)[1], None)
    with LiveProgress(100) as progress:
        progress.motions_started()
        progress.task_started("mjx:rk4 on tumbling")
        progress.case_done()
        assert any("motions 1/100 cases (mjx:rk4 on tumbling), elapsed 0:00\n" in text for text in lines)
    with status_line("drawing the frames"):
        assert any("drawing the frames, elapsed 0:00\n" in text for text in lines)
    capsys.readouterr()
    with status_line("drawing the frames", quiet=True):
        time.sleep(0.05)
    assert capsys.readouterr().err == ""


@pytest.fixture(scope="module")
def run(stored_run: Path) -> Run:
    """Return a run in which one case failed."""
    return read_run(stored_run, allow_code=False, cache=Cache.default())


def summary(run: Run, monkeypatch: pytest.MonkeyPatch, output: io.StringIO, columns: str = "200") -> str:
    """Return the printed summary of a run."""
    monkeypatch.setattr("sys.stdout", output)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", columns)
    print_document(run_document(run))
    return output.getvalue()


@pytest.mark.slow
def test_the_summary_begins_with_the_conclusion_and_ends_with_the_worst_and_their_commands(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each method has one line; failures have number, reason and the command that repeats them."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    shown = summary(run, monkeypatch, io.StringIO()).splitlines()
    assert shown[0] == "Findings in 1 of 5 methods: failing:m1; 4 converge or are at the floor."
    assert f"{len(run.cases)} cases in " in shown[-1]
    for method in ("reference:m1", "reference:rk4", "reference:exact", "reference:taylor", "failing:m1"):
        assert sum(bool(re.match(rf"{method} .*, .*[a-z]", line)) for line in shown) >= 1
    place = shown.index("Worst result of each method") + 2
    assert re.match("failing:m1 +failed in 1 case: RuntimeError", shown[place])
    assert shown[place].endswith(" in forced, and a mesh")
    assert shown[place + 1].strip() == next(
        case.columns["reproduce"] for case in run.cases if case.columns["outcome"] == "failed"
    )


@pytest.mark.slow
@pytest.mark.parametrize("quiet", [True, False])
def test_colour_is_for_terminals_that_want_it(quiet: bool, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal has colour unless NO_COLOR is set; a pipe has none, and unbroken lines without COLUMNS."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    if quiet:
        monkeypatch.setenv("NO_COLOR", "1")
    colour = re.compile(r"\x1b\[[0-9;]*3[0-7]m")
    assert bool(colour.search(summary(run, monkeypatch, Terminal()))) is not quiet
    piped = summary(run, monkeypatch, io.StringIO(), columns="")
    assert "\x1b" not in piped
    assert any(re.match(r"reference:m1 .*converges.* dt .* s", line) for line in piped.splitlines())


@pytest.mark.slow
def test_every_faulty_method_has_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """A method that is invalid many times does not displace the others; its further findings are counted."""
    failed = next(case for case in run.cases if case.columns["outcome"] == "failed")
    more = [
        replace(failed, columns={**failed.columns, "outcome": outcome, "message": f"{k}"})
        for k in range(12)
        for outcome in ("timeout", "invalid")
    ]
    shown = summary(replace(run, cases=(*run.cases, *more)), monkeypatch, io.StringIO()).splitlines()
    (line,) = [line for line in shown if re.match("failing:m1 +invalid in 12 cases: ", line)]
    assert line.endswith("; 2 more findings")


def test_speeds_are_counted_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The count of speeds starts from 0, and is complete when all cases have been timed."""
    terminal = terminal_of(monkeypatch)
    with LiveProgress(2) as progress:
        progress.motions_started()
        for _ in range(3):
            progress.case_done()
        progress.speeds_started()
        for _ in range(3):
            progress.speed_measured()
        shown = last_line(terminal, progress)
    assert "speeds, one case at a time 3/3 cases" in shown
