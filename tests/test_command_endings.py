"""How commands end: each way has one line of output and its own exit status."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bodycheck._util.untrusted import LONGEST_LINE, doing, printable, printable_lines, shell_join, shell_split
from tests.helpers.in_process_cli import run_bodycheck


@pytest.fixture
def faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which tracebacks are kept."""
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "faults"


class _UnprintableError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


UNEXPECTED: dict[str, Callable[[], BaseException]] = {
    "TypeError: 3": lambda: TypeError(3),
    "OSError: [Errno 5] Input/output error": lambda: OSError(5, "Input/output error"),
    "_UnprintableError": _UnprintableError,
    r"ValueError: \x1b[31m": lambda: ValueError("\x1b[31m" + 10_000 * "z"),
}


def test_traceback_of_an_unexpected_error_is_printed_on_request(
    faults: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """BODYCHECK_TRACEBACK=1 prints it before the line, which still comes last and names the stored one."""

    def broken(*_: object) -> NoReturn:
        raise TypeError(3)

    monkeypatch.setattr("bodycheck.reports.summary.catalogue.catalogue", broken)
    monkeypatch.setenv("BODYCHECK_TRACEBACK", "1")
    done = run_bodycheck(tmp_path, "list", "suites")
    assert done.returncode == 70
    *shown, line = done.stderr.splitlines()
    assert shown[0] == "Traceback (most recent call last):"
    assert shown[-1] == "TypeError: 3"
    assert line.startswith("unexpected error in bodycheck list suites: TypeError: 3")
    assert len(list(faults.iterdir())) == 1


@pytest.mark.parametrize("words", UNEXPECTED)
def test_unexpected_exception_is_one_line_and_status_70(
    words: str, faults: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line names the action, the file and the file that stores the traceback."""

    def broken(*_: object) -> NoReturn:
        with doing("reading suites.json"):
            raise UNEXPECTED[words]()

    monkeypatch.setattr("bodycheck.reports.summary.catalogue.catalogue", broken)
    done = run_bodycheck(tmp_path, "list", "suites")
    assert done.returncode == 70
    (line,) = done.stderr.splitlines()
    assert len(line) <= LONGEST_LINE
    assert line.isprintable()
    assert line.startswith(f"unexpected error in bodycheck list suites (reading suites.json): {words}")
    (kept,) = faults.iterdir()
    assert f"its traceback is stored in {kept}; please report it" in line
    assert "Traceback (most recent call last)" in kept.read_text()
    assert "in broken" in kept.read_text()


def test_lack_of_memory_is_one_line_and_status_2(
    faults: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is no fault of bodycheck: the line says so, and no traceback is stored."""

    def broken(*_: object) -> NoReturn:
        raise MemoryError

    monkeypatch.setattr("bodycheck.reports.summary.catalogue.catalogue", broken)
    done = run_bodycheck(tmp_path, "list", "suites")
    assert (done.returncode, done.stderr) == (2, "out of memory\n")
    assert not faults.exists()


def test_wrong_usage_is_printed_escaped(tmp_path: Path) -> None:
    """Arguments from the shell are printed escaped, and the status is 2."""
    done = run_bodycheck(tmp_path, "run", "--\x1b[31m", "\x07.toml")
    assert done.returncode == 2
    assert r"\x1b[31m" in done.stderr
    assert all(line.isprintable() for line in done.stderr.split("\n"))


@pytest.mark.slow
@given(st.text())
def test_printable_line_is_printable_and_short(text: str) -> None:
    """Any text becomes one line of at most 500 characters; printable text is unchanged."""
    line = printable(text * 40)
    assert line.isprintable()
    assert len(line) <= LONGEST_LINE
    if text.isprintable() and len(text) <= LONGEST_LINE:
        assert printable(text) == text
    assert len(printable_lines(text).split("\n")) == len(text.split("\n"))


def test_printable_line_keeps_both_ends() -> None:
    """A long line is cut in the middle, because its end states the remedy."""
    line = printable("begin" + 1000 * "z" + "the remedy")
    assert line.startswith("beginzz")
    assert line.endswith("zthe remedy")
    assert " ... " in line


@given(st.lists(st.binary(max_size=8).map(lambda word: os.fsdecode(word.replace(b"\0", b"")))))
def test_command_line_survives_as_bytes(words: list[str]) -> None:
    """A joined command line of any bytes can be written as UTF-8 and split into the same arguments again."""
    line = shell_join(words)
    assert shell_split(line) == words
    line.encode("utf-8")
    assert "\n" not in line


def test_bash_splits_a_joined_command_line() -> None:
    """Bash splits a joined command line into the original arguments."""
    words = [os.fsdecode(word) for word in (b"caf\xe9.toml", b"a b'c", b"\xff$HOME\n", b"x")]
    result = subprocess.run(
        ["bash", "-c", rf"printf '%s\0' {shell_join(words)}"], capture_output=True, check=True
    )
    assert result.stdout.split(b"\0")[:-1] == [os.fsencode(word) for word in words]


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("shell", "status", "printed"),
    [
        ("{0} list suites > /dev/full", 2, "standard output: cannot be written: No space left on device\n"),
        ("{0} list suites | true; exit ${{PIPESTATUS[0]}}", None, ""),
        ("{0} list suites >&-", 0, ""),
    ],
)
def test_closed_or_full_output_ends_a_command_cleanly(shell: str, status: int | None, printed: str) -> None:
    """A full device is a user's error; a closed or missing reader of the output is not an error."""
    command = shell.format(f"{sys.executable} -m bodycheck")
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stderr == printed
    assert done.returncode == status or (status is None and done.returncode in (0, 128 + signal.SIGPIPE))


WAITING = """
import time
from bodycheck.cli import commands as cli
from bodycheck.reports.summary import catalogue

def wait(*_):
    print("waiting", flush=True)
    time.sleep(100)

catalogue.catalogue = wait
import sys
sys.argv = ["bodycheck", "list", "suites"]
cli.main()
"""

CAUGHT_IN_EXEC = """
import signal
import sys

import bodycheck.reports.summary.catalogue as catalogue
from bodycheck.__main__ import main

catalogue.catalogue = lambda *_: exec("signal.raise_signal(signal.SIGTERM)", {"signal": signal})
sys.argv = ["bodycheck", "list", "suites"]
main()
"""


def test_signal_within_exec_keeps_its_status(tmp_path: Path) -> None:
    """The status is kept although CPython loses an interrupt in exec(), which dataclasses call at import."""
    (tmp_path / "stopping.py").write_text(CAUGHT_IN_EXEC)
    done = subprocess.run(
        [sys.executable, "-m", "stopping"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (143, "stopped\n")


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)], ids=str
)
def test_signal_ends_a_command_like_an_interrupt(number: signal.Signals, status: int) -> None:
    """A signal gives one line and the status that a shell expects, without a traceback."""
    with subprocess.Popen(
        [sys.executable, "-c", WAITING],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a shell starts background jobs with Ctrl-C ignored, and the tests' own process may be such a job
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL) and None,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "waiting\n"
        process.send_signal(number)
        _, printed = process.communicate(timeout=60)
    assert (process.returncode, printed) == (status, "stopped\n")
