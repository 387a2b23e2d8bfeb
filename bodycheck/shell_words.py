r"""Words of a command line as a shell reads them, those that are not UTF-8 text as bytes: $'caf\xe9.toml'."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable

_PLAIN = "A-Za-z0-9_./+@%:,=-"
_BYTES = re.compile(rf"(?:^|(?<= ))\$'((?:[{_PLAIN}]|\\x[0-9a-f]{{2}})*)'(?= |$)")
_SPECIAL = re.compile(r"['\"\\#]")
_ESCAPE = re.compile(rb"\\x([0-9a-f]{2})")


def joined(words: Iterable[str]) -> str:
    """Return the words as one line that a shell takes apart into them again."""
    return " ".join(quoted(word) for word in words)


def quoted(word: str) -> str:
    """Return a word as a shell reads it; one that is not printable text has its bytes escaped for bash."""
    if word.isprintable():
        return shlex.quote(word)
    return "$'" + re.sub(rb"[^" + _PLAIN.encode() + rb"]", _escape, os.fsencode(word)).decode() + "'"


def _escape(found: re.Match[bytes]) -> bytes:
    return f"\\x{found[0][0]:02x}".encode()


def parted(line: str) -> list[str]:
    """Return the words of a line that `joined` made; ValueError where a quotation mark is left open."""
    if not _SPECIAL.search(line):  # as nearly always: shlex is slow
        return line.split()
    words: list[str] = []
    end = 0
    for found in _BYTES.finditer(line):
        words += shlex.split(line[end : found.start()])
        content = _ESCAPE.sub(lambda hexadecimal: bytes.fromhex(hexadecimal[1].decode()), found[1].encode())
        words.append(os.fsdecode(content))
        end = found.end()
    return words + shlex.split(line[end:])
