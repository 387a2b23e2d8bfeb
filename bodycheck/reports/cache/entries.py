"""Messages as checksummed lines: the hash of the text, a space, the text."""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from bodycheck._util.files import opened, sealed
from bodycheck.adapters.workers.protocol import Message


@dataclass(frozen=True, eq=False)
class Entry:
    """A message with its key, and the checksummed line of both, which the cache and the journal share."""

    key: str
    value: Message
    line: bytes

    @classmethod
    def of(cls, key: str, value: Message) -> Entry:
        """Return the entry of a message, with its checksum."""
        return cls(key, value, sealed({"key": key, "value": value}))

    @classmethod
    def read(cls, line: bytes) -> Entry | None:
        """Return the entry of a line; None where the line is truncated or changed."""
        message = opened(line)
        return None if message is None else cls(message["key"], message["value"], line)


def key_of(**parts: Any) -> str:
    """Return the hash of plain data: equal if and only if all the data are equal."""
    text = json.dumps(parts, sort_keys=True)
    return sha256(text.encode()).hexdigest()
