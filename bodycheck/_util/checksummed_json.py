"""Plain data as a line that knows whether it is whole: the hash of its text, a blank, the text as JSON."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any


def sealed(message: dict[str, Any]) -> bytes:
    """Return a message as one line, newline included."""
    text = json.dumps(message, separators=(",", ":")).encode()
    return sha256(text).hexdigest().encode() + b" " + text + b"\n"


def opened(line: bytes) -> dict[str, Any] | None:
    """Return the message of a line; None where it is cut off or changed."""
    digest, _, text = line.removesuffix(b"\n").partition(b" ")
    if not line.endswith(b"\n") or sha256(text).hexdigest().encode() != digest:
        return None
    message: dict[str, Any] = json.loads(text)
    return message
