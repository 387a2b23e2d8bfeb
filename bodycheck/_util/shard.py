"""Deterministic division of work among machines that do not communicate: `--shard 3/8`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from hashlib import sha256

from bodycheck._util.errors import InputError

_MAX_COUNT = 100_000


@dataclass(frozen=True)
class Shard:
    """Part `index` of `count`, counted from 1."""

    index: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Return the shard of a text like 3/8; raises InputError for any other text."""
        found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
        if found is not None:
            shard = cls(int(found[1]), int(found[2]))
            if 1 <= shard.index <= shard.count <= _MAX_COUNT:
                return shard
        raise InputError(f"--shard {text}: must be K/N with 1 <= K <= N, like 3/8")

    def has(self, *unit: str) -> bool:
        """Whether this shard does a unit of work: SHA-256(unit) mod count = index - 1.

        unit: the words that name it, the same on every machine. A unit must not depend on the results of
        another. Exactly one of the shards 1/n ... n/n has it.
        """
        return self.owner(*unit) == self.index

    def owner(self, *unit: str) -> int:
        """Return the index of the shard that does a unit of work."""
        digest = sha256("\0".join(unit).encode("utf-8", "surrogateescape")).digest()
        return 1 + int.from_bytes(digest[:8], "big") % self.count

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"
