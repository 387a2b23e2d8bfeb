"""Messages as lines that know whether they are whole: the hash of the text, a blank, the text."""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from bodycheck._util.checksummed_json import opened, sealed
from bodycheck.adapters.workers.protocol import Message


@dataclass(frozen=True, eq=False)
class Entry:
    """A message under its key, with the sealed line that holds both: sealed once, wherever it is kept."""

    key: str
    value: Message
    line: bytes

    @classmethod
    def of(cls, key: str, value: Message) -> Entry:
        """Seal a message."""
        return cls(key, value, sealed({"key": key, "value": value}))

    @classmethod
    def read(cls, line: bytes) -> Entry | None:
        """Return what a line holds; None where it is cut off or changed."""
        message = opened(line)
        return None if message is None else cls(message["key"], message["value"], line)


def key_of(**parts: Any) -> str:
    """Return the hash of plain data: equal where, and only where, all of it is."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    return sha256(text.encode()).hexdigest()
