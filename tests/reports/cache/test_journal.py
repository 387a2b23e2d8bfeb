"""The journal: complete entries are read again, damaged ones are ignored."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bodycheck._util.errors import InputError
from bodycheck._util.files import opened, sealed
from bodycheck.reports.cache.disk_cache import key_of
from bodycheck.reports.cache.journal import Journal
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.file_size_limit import file_size_limit

ENTRIES: dict[str, dict[str, Any]] = {
    "a": {"outcome": "ok", "trajectory": "x" * 300},
    "b": {"outcome": "failed", "message": "a \u2028 b"},
    "c": {"outcome": "timeout", "message": "late"},
}


def written(path: Path) -> list[bytes]:
    """Write the entries to a journal and return its lines."""
    with Journal(path) as journal:
        for key, value in ENTRIES.items():
            journal.put(key, value)
    return path.read_bytes().splitlines(keepends=True)


def held(path: Path) -> dict[str, Any]:
    """Return what a journal holds of the entries when it is opened."""
    with Journal(path) as journal:
        return {key: value for key in ENTRIES if (value := journal.get(key)) is not None}


def test_entries_are_read_when_it_is_opened_again(tmp_path: Path) -> None:
    """Every entry comes back equal; other keys are absent."""
    written(tmp_path / "journal")
    assert held(tmp_path / "journal") == ENTRIES
    with Journal(tmp_path / "journal") as journal:
        assert journal.get("d") is None


def test_journal_is_empty_until_something_is_written(tmp_path: Path) -> None:
    """A run that measured nothing leaves nothing to continue."""
    with Journal(tmp_path / "journal") as journal:
        assert journal.is_empty
        journal.put("a", ENTRIES["a"])
        assert not journal.is_empty
    with Journal(tmp_path / "journal") as journal:
        assert not journal.is_empty


@pytest.mark.parametrize("kept", [0, 1, 64, 65, 66, 100, -1])
def test_truncated_line_is_dropped_and_written_again(kept: int, tmp_path: Path) -> None:
    """Wherever the last line was cut, the others stay, and the journal continues after them."""
    path = tmp_path / "journal"
    lines = written(path)
    path.write_bytes(b"".join(lines[:2]) + lines[2][:kept])
    assert held(path) == {key: ENTRIES[key] for key in "ab"}
    with Journal(path) as journal:
        journal.put("c", ENTRIES["c"])
    assert path.read_bytes() == b"".join(lines)


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "one bit": lambda line: line[:90] + bytes([line[90] ^ 1]) + line[91:],
    "zeros": lambda line: bytes(len(line) - 1) + b"\n",
    "a digest alone": lambda line: line[:64] + b"\n",
    "no digest": lambda line: line[65:],
    "an empty line": lambda _: b"\n",
    "a line too many": lambda line: b"\xff\xfe\n" + line[:70] + b"\n",
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("place", [0, 1, 2])
def test_damaged_line_is_skipped(damage: str, place: int, tmp_path: Path) -> None:
    """Of three lines the other two are read, wherever the damaged one stands."""
    path = tmp_path / "journal"
    lines = written(path)
    lines[place] = DAMAGES[damage](lines[place])
    path.write_bytes(b"".join(lines))
    assert held(path) == {key: value for i, (key, value) in enumerate(ENTRIES.items()) if i != place}


@pytest.mark.parametrize("torn", [b"", b"torn"])
@pytest.mark.parametrize("room", [0, 1, 30])
def test_full_disk_leaves_complete_lines(
    room: int, torn: bytes, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The entry without room is refused in one line; with room the journal continues."""
    path = tmp_path / "journal"
    lines = written(path)
    path.write_bytes(lines[0] + torn)
    with Journal(path) as journal:
        journal.put("b", ENTRIES["b"])
        with (
            file_size_limit(len(b"".join(lines[:2])) + room),
            expected_message.raises(InputError),
        ):
            journal.put("c", ENTRIES["c"])
        assert path.read_bytes() == b"".join(lines[:2])
        journal.put("c", ENTRIES["c"])
    assert path.read_bytes() == b"".join(lines)


def test_second_process_is_refused(tmp_path: Path) -> None:
    """One process at a time holds the journal; the other gets one line, and neither damages it."""
    path = tmp_path / "journal"
    code = "import sys; from pathlib import Path; from bodycheck.reports.cache.journal import Journal; "
    words = [sys.executable, "-c", f"{code} Journal(Path({str(path)!r}))"]
    with Journal(path) as journal:
        journal.put("a", ENTRIES["a"])
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        journal.put("b", ENTRIES["b"])
    assert done.returncode == 1
    last_line = done.stderr.splitlines()[-1]
    assert last_line.endswith(f"InputError: {path}: another process is using this run")
    assert subprocess.run(words, check=False).returncode == 0
    assert held(path) == {key: ENTRIES[key] for key in "ab"}


def test_unwritable_journal_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """The message names the file and the reason."""
    with expected_message.raises(InputError):
        Journal(tmp_path / "nowhere/journal")


@pytest.mark.parametrize("message", [{}, {"a": [1, None, "\u2028\x00"]}, {"pi": 3.141592653589793}])
def test_checksum_detects_every_changed_byte(message: dict[str, Any]) -> None:
    """A checked message is read back equal; a line that differs in any byte is refused."""
    line = sealed(message)
    assert line.count(b"\n") == 1
    assert opened(line) == message
    for place in range(len(line)):
        assert opened(line[:place] + bytes([line[place] ^ 4]) + line[place + 1 :]) is None


def test_key_depends_on_all_data_but_not_their_order() -> None:
    """Equal data have equal keys; the last bit of a number changes the key."""
    assert key_of(a=1.0, b=[1, 2]) == key_of(b=[1, 2], a=1.0)
    assert key_of(a=0.1) != key_of(a=0.1 + 2**-56)
    assert key_of(a=[1, 2]) != key_of(a=[2, 1])
