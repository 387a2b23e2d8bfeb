"""Deterministic division of work among machines that do not communicate: `--shard 3/8`."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

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


def division_faults(shards: Mapping[Path, Shard]) -> Iterator[str]:
    """Yield why the folders are not all shards of one division.

    The reasons: a shard is missing, given twice, or of another division.
    """
    folders: dict[Shard, list[Path]] = {}
    for folder, shard in shards.items():
        folders.setdefault(shard, []).append(folder)
    counts = Counter(shard.count for shard in shards.values())
    if len(counts) > 1:
        listed = ", ".join(f"{folder} is {shard}" for folder, shard in shards.items())
        yield f"shards of different divisions: {listed}"
        return
    (total,) = counts
    for shard, same in folders.items():
        if len(same) > 1:
            yield f"{', '.join(map(str, same))}: all are shard {shard}"
    absent = [str(Shard(k, total)) for k in range(1, total + 1) if Shard(k, total) not in folders]
    if absent:
        yield f"missing shard{'s' * (len(absent) > 1)}: {', '.join(absent)}"
