"""However a command line ends, it ends with a line and a status of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest
from front_door import bodycheck_in
from hypothesis import given
from hypothesis import strategies as st

from bodycheck._util.untrusted import LONGEST_LINE, doing, joined, parted, printable, printable_lines


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
    "MemoryError": MemoryError,
    "_UnprintableError": _UnprintableError,
    r"ValueError: \x1b[31m": lambda: ValueError("\x1b[31m" + 10_000 * "z"),
}


@pytest.mark.parametrize("words", UNEXPECTED)
def test_unexpected_exception_is_one_line_and_status_70(
    words: str, faults: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line says what was being done, which file, where the traceback is; that file has it."""

    def broken(_: str) -> NoReturn:
        with doing("reading suites.json"):
            raise UNEXPECTED[words]()

    monkeypatch.setattr("bodycheck.reports.summary.catalogue.print_catalogue", broken)
    done = bodycheck_in(tmp_path, "list", "suites")
    assert done.returncode == 70
    (line,) = done.stderr.splitlines()
    assert len(line) <= LONGEST_LINE
    assert line.isprintable()
    assert line.startswith(f"unexpected error in bodycheck list suites (reading suites.json): {words}")
    (kept,) = faults.iterdir()
    assert f"its traceback is stored in {kept}; please report it" in line
    assert "Traceback (most recent call last)" in kept.read_text()
    assert "in broken" in kept.read_text()


def test_wrong_usage_cannot_reach_the_terminal_unescaped(tmp_path: Path) -> None:
    """What a shell passes on is shown escaped, and the status is 2."""
    done = bodycheck_in(tmp_path, "run", "--\x1b[31m", "\x07.toml")
    assert done.returncode == 2
    assert r"\x1b[31m" in done.stderr
    assert all(line.isprintable() for line in done.stderr.split("\n"))


@given(st.text())
def test_printable_line_is_printable_and_short(text: str) -> None:
    """Whatever the text, one line of at most 500 characters; text that is printable already stays."""
    line = printable(text * 40)
    assert line.isprintable()
    assert len(line) <= LONGEST_LINE
    if text.isprintable() and len(text) <= LONGEST_LINE:
        assert printable(text) == text
    assert len(printable_lines(text).split("\n")) == len(text.split("\n"))


def test_printable_line_keeps_both_ends() -> None:
    """What is left out is the middle: the end says what to do."""
    line = printable("begin" + 1000 * "z" + "the remedy")
    assert line.startswith("beginzz")
    assert line.endswith("zthe remedy")
    assert " ... " in line


@given(st.lists(st.binary(max_size=8).map(lambda word: os.fsdecode(word.replace(b"\0", b"")))))
def test_command_line_survives_as_bytes(words: list[str]) -> None:
    """What is joined comes apart again, whatever bytes the words have, and can be written as UTF-8."""
    line = joined(words)
    assert parted(line) == words
    line.encode("utf-8")
    assert "\n" not in line


def test_command_line_is_read_by_bash_as_it_was_joined() -> None:
    """The words that a shell makes of a line are those of which it was made."""
    words = [os.fsdecode(word) for word in (b"caf\xe9.toml", b"a b'c", b"\xff$HOME\n", b"x")]
    told = subprocess.run(["bash", "-c", rf"printf '%s\0' {joined(words)}"], capture_output=True, check=True)
    assert told.stdout.split(b"\0")[:-1] == [os.fsencode(word) for word in words]


@pytest.mark.parametrize(
    ("shell", "status", "said"),
    [
        ("{0} list suites > /dev/full", 2, "standard output: cannot be written: No space left on device\n"),
        ("{0} list suites | true; exit ${{PIPESTATUS[0]}}", None, ""),
        ("{0} list suites >&-", 0, ""),
    ],
)
def test_output_that_nobody_takes_ends_a_command_in_order(shell: str, status: int | None, said: str) -> None:
    """A full device is the caller's to put right; a reader that left, or none at all, is no fault."""
    command = shell.format(f"{sys.executable} -m bodycheck")
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stderr == said
    assert done.returncode == status or (status is None and done.returncode in (0, 128 + signal.SIGPIPE))


WAITING = """
import time
from bodycheck.cli import commands as cli
from bodycheck.reports.summary import catalogue

def wait(_):
    print("waiting", flush=True)
    time.sleep(100)

catalogue.print_catalogue = wait
import sys
sys.argv = ["bodycheck", "list", "suites"]
cli.main()
"""


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)], ids=str
)
def test_signal_ends_a_command_like_an_interrupt(number: signal.Signals, status: int) -> None:
    """One line and the status that a shell expects, no traceback."""
    with subprocess.Popen(
        [sys.executable, "-c", WAITING],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a shell has its background jobs ignore Ctrl-C, and so may the tests' own process
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL) and None,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "waiting\n"
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (status, "stopped\n")
