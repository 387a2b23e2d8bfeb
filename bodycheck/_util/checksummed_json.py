"""Plain data as a line with a checksum: SHA-256 of the text, a space, the text as JSON."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any


def sealed(message: dict[str, Any]) -> bytes:
    """Return a message as one line with its checksum, newline included."""
    text = json.dumps(message, separators=(",", ":")).encode()
    return sha256(text).hexdigest().encode() + b" " + text + b"\n"


def opened(line: bytes) -> dict[str, Any] | None:
    """Return the message of a line; None if the line is truncated or altered."""
    digest, _, text = line.removesuffix(b"\n").partition(b" ")
    if not line.endswith(b"\n") or sha256(text).hexdigest().encode() != digest:
        return None
    message: dict[str, Any] = json.loads(text)
    return message
