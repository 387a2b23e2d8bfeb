"""What a run shows while it goes on."""

from __future__ import annotations

import io
import re
import time

import pytest

from bodycheck.reports.terminal import LiveProgress


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
