"""Handle untrusted input: files, text for a terminal, JSON and TOML, words of a shell command."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import stat
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from bodycheck._util.errors import BodycheckError, InputError
from bodycheck._util.formatting import unread

LONGEST_LINE = 500
_TAIL = 200  # the end of a message says what to do
_CUT = " ... "
_SHORT = 200


FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""A cell that begins with one of these is a formula for programs that open CSV files."""


def no_formula(cell: Any) -> Any:
    """Return a cell of a CSV file: text that begins like a formula gets a leading space."""
    return f" {cell}" if isinstance(cell, str) and cell.startswith(FORMULA) else cell


def printable(text: str, longest: int = LONGEST_LINE) -> str:
    """Return text as one line: escape control characters, and leave out the middle of long text."""
    if len(text) > 2 * longest:  # escaping can only lengthen it
        text = text[:longest] + text[-longest:]
    line = _escaped(text, "")
    tail = min(_TAIL, longest // 2)
    return line if len(line) <= longest else line[: longest - tail - len(_CUT)] + _CUT + line[-tail:]


def printable_lines(text: str) -> str:
    """Return text with each of its lines made printable."""
    return "\n".join(printable(line) for line in text.split("\n"))


def _escaped(text: str, kept: str) -> str:
    """Return text with its control characters escaped, except those that are kept."""
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in kept else c.encode("unicode_escape").decode("ascii") for c in text
    )


def escaped(value: Any) -> Any:
    """Return plain data with the control characters of its strings escaped, except line breaks."""
    match value:
        case str():
            return _escaped(value, "\n")
        case list():
            return [escaped(part) for part in value]
        case dict():
            return {escaped(name): escaped(part) for name, part in value.items()}
    return value


@contextmanager
def doing(what: str) -> Iterator[None]:
    """Add a note to an unexpected exception that states what was being done, for the line that reports it."""
    try:
        yield
    except BodycheckError:
        raise
    except Exception as error:
        error.add_note(what)
        raise


@contextmanager
def from_outside(where: Path) -> Iterator[None]:
    """Turn any exception caused by outside data into an InputError that names its file."""
    try:
        yield
    except BodycheckError:
        raise
    except Exception as error:
        reason = printable(f"{type(error).__name__}: {error}", _SHORT)
        raise InputError(f"{where}: cannot be used: {reason}") from error


MAX_FILE_BYTES = 1 << 30
_MAX_TEXT_BYTES = 1 << 26  # TOML and JSON need some twenty times their size in memory
_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def open_input(path: Path, max_bytes: int = MAX_FILE_BYTES) -> BinaryIO:
    """Open a file that the user or another file names, for reading; all such files are opened here.

    max_bytes: the largest size that the reader can hold in memory. Raises OSError if the file cannot be
    opened, InputError if it is not a regular file, which could block or have no end, or is too large.
    """
    try:
        check_regular(path)  # opening a device can have effects
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY), "rb")
    except ValueError as error:  # a NUL character in the path
        raise InputError(f"{printable(str(path))}: cannot be read: {error}") from None
    status = os.fstat(file.fileno())
    fault = None if stat.S_ISREG(status.st_mode) else "is not a regular file"
    if status.st_size > max_bytes:
        fault = f"too large, {status.st_size} bytes (limit: {max_bytes})"
    if fault is not None:
        file.close()
        raise InputError(f"{path}: {fault}")
    return file


def check_regular(path: Path) -> None:
    """Raise OSError if there is no such file, InputError if it is neither a regular file nor a folder."""
    kind = stat.S_IFMT(path.stat().st_mode)
    if kind == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if kind != stat.S_IFREG:
        raise InputError(f"{path}: is {_KINDS.get(kind, 'something else')}, not a regular file")


def read_bytes(path: Path, max_bytes: int = MAX_FILE_BYTES, *, from_shell: bool = False) -> bytes:
    """Return the content of a file; raises as `open_input` does.

    from_shell: whether to read a pipe that the shell made, as in `... | bodycheck judge /dev/stdin`.
    """
    is_pipe = from_shell and (path == Path("/dev/stdin") or path.parent == Path("/dev/fd"))
    if is_pipe and stat.S_ISFIFO(path.stat().st_mode):
        with path.open("rb") as pipe:
            content = pipe.read(max_bytes + 1)
    else:
        with open_input(path, max_bytes) as file:
            content = file.read(max_bytes + 1)
    if len(content) > max_bytes:  # it has grown, or its system does not know its size
        raise InputError(f"{path}: too large (limit: {max_bytes} bytes)")
    return content


def read_json(path: Path, *, escape: bool = True) -> Any:
    """Return the content of a JSON file; escape: whether to escape control characters in its strings.

    Raises FileNotFoundError if there is no file, InputError with one line if it cannot be read.
    """
    try:
        content = json.loads(read_bytes(path, _MAX_TEXT_BYTES).decode("utf-8"))
        return escaped(content) if escape else content
    except FileNotFoundError:
        raise
    except OSError as error:
        raise InputError(unread(path, error)) from None
    except RecursionError:
        raise InputError(f"{path}: is not JSON: it is nested too deeply") from None
    except ValueError as error:
        raise InputError(f"{path}: is not JSON: {error}") from None


def read_text(path: Path) -> str:
    """Read a UTF-8 text file, without a byte order mark; raise InputError if it cannot be read."""
    try:
        return read_bytes(path, _MAX_TEXT_BYTES).decode("utf-8-sig")
    except OSError as error:
        raise InputError(unread(path, error)) from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text: {error.reason} at byte {error.start}") from None


_NUMBER = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|inf|infinity|nan)", re.ASCII | re.IGNORECASE
)


def number_of(word: str) -> float:
    """Return a decimal number; raises ValueError for digits of other scripts, 1_000 and blanks.

    float() reads these, but no engine and no other program does.
    """
    if not _NUMBER.fullmatch(word):
        raise ValueError(f"{word!r} is not a number")
    return float(word)


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return the content of TOML text; raises InputError with one line, which names `where`, if invalid."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{where}: is nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: is not TOML: {error}") from None
    except ValueError:  # int() limits the number of digits
        raise InputError(f"{where}: has an integer with too many digits") from None


_PLAIN = "A-Za-z0-9_./+@%:,=-"
_BYTES = re.compile(rf"(?:^|(?<= ))\$'((?:[{_PLAIN}]|\\x[0-9a-f]{{2}})*)'(?= |$)")
_SPECIAL = re.compile(r"['\"\\#]")
_ESCAPE = re.compile(rb"\\x([0-9a-f]{2})")


def shell_join(words: Iterable[str]) -> str:
    """Return the words as one line that a shell splits into the same words."""
    return " ".join(shell_quote(word) for word in words)


def shell_quote(word: str) -> str:
    """Return a word quoted for a shell; escape the bytes of an unprintable word for bash."""
    if word.isprintable():
        return shlex.quote(word)
    return "$'" + re.sub(rb"[^" + _PLAIN.encode() + rb"]", _escape, os.fsencode(word)).decode() + "'"


def _escape(found: re.Match[bytes]) -> bytes:
    return f"\\x{found[0][0]:02x}".encode()


def shell_split(line: str) -> list[str]:
    """Return the words of a line made by `shell_join`; raises ValueError for an unclosed quotation mark."""
    if not _SPECIAL.search(line):  # the common case; shlex is slow
        return line.split()
    words: list[str] = []
    end = 0
    for found in _BYTES.finditer(line):
        words += shlex.split(line[end : found.start()])
        content = _ESCAPE.sub(lambda hexadecimal: bytes.fromhex(hexadecimal[1].decode()), found[1].encode())
        words.append(os.fsdecode(content))
        end = found.end()
    return words + shlex.split(line[end:])
