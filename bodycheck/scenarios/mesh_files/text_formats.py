"""Shared by the readers of text formats: split lines of any encoding, parse numbers."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from io import BufferedIOBase, TextIOWrapper
from typing import BinaryIO, cast

import numpy as np

from bodycheck.reference_impl.arrays import Array

_BLANK = re.compile(r"[ \t\r\n\v\f]+")
_INTEGER = re.compile(r"[+-]?[0-9]{1,20}")
UTF_16_NOTE = "the file is UTF-16 text"


def encoding_of(file: BufferedIOBase) -> str:
    """Return the encoding of a text file by its byte order mark or the zero bytes of UTF-16; rewind it."""
    file.seek(0)
    match list(file.read(4)):
        case [0xEF, 0xBB, 0xBF, *_]:
            found = "utf-8-sig"
        case [0xFF, 0xFE, *_] | [0xFE, 0xFF, *_]:
            found = "utf-16"
        case [first, 0, second, 0] if first and second:
            found = "utf-16-le"
        case [0, first, 0, second] if first and second:
            found = "utf-16-be"
        case _:
            found = "utf-8"
    file.seek(0)
    return found


def encoding_notes(encoding: str) -> tuple[str, ...]:
    """Return a note on an encoding that other readers of these formats do not expect."""
    return (UTF_16_NOTE,) if encoding.startswith("utf-16") else ()


def split_lines(file: BufferedIOBase, first: int = 1, comment: str = "") -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, words) of each line that is not blank, counting from `first`.

    Lines end with LF, CRLF or CR. comment: the character that begins one, up to the end of its line.
    """
    lines = TextIOWrapper(cast(BinaryIO, file), encoding_of(file), errors="replace")
    try:
        for number, line in enumerate(lines, first):
            text = line.partition(comment)[0] if comment and comment in line else line
            # str.split() also splits at no-break spaces, unlike other readers
            words = text.split() if text.isascii() else [word for word in _BLANK.split(text) if word]
            if words:
                yield number, words
    finally:
        if not file.closed:
            lines.detach()  # otherwise it would close the file


def floats(words: Sequence[str], line: int) -> list[float]:
    """Return words as floats. Raises ValueError with the line number."""
    text = "".join(words)
    try:
        if not text.isascii() or "_" in text:  # float() reads digits of other scripts, and 1_000
            raise ValueError(text)
        return [float(word) for word in words]
    except ValueError:
        hint = "; a decimal point is expected" if any("," in word for word in words) else ""
        raise ValueError(f"line {line}: not all of {quoted(words)} are numbers{hint}") from None


def integer(word: str, line: int) -> int:
    """Return a word as an integer of at most 31 bits. Raises ValueError with the line number."""
    if not _INTEGER.fullmatch(word):
        raise ValueError(f"line {line}: {quoted([word])} is not an integer")
    value = int(word)
    if abs(value) >= 1 << 31:
        raise ValueError(f"line {line}: {quoted([word])} is out of range")
    return value


def quoted(words: Iterable[str]) -> str:
    """Return words for a message: quoted, printable, at most 60 characters."""
    text = " ".join(words)
    return repr(text if len(text) <= 60 else text[:57] + "...")


def points(coordinates: array[float]) -> Array:
    """Return consecutive coordinates (3 n,) as an array (n, 3); n may be zero."""
    return np.asarray(coordinates, dtype=np.float64).reshape(-1, 3)
