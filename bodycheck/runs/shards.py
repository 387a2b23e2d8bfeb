"""Shards as stored: whether they belong together, and how the machines that made them differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from bodycheck._util.errors import InputError
from bodycheck._util.shard import Shard
from bodycheck.reports.run_files.sentinels import (
    MachineAnswer,
    differing_facts,
    disagreements,
    read_sentinels,
)

_LONGEST = 200
"""Characters of two values that a message still shows."""


@dataclass(frozen=True, eq=False)
class StoredShard:
    """A shard of a run, an ensemble or an audit.

    request: what must be equal in all shards, by name; a name that one of two lacks is not compared.
    facts: what may affect the results, by name.
    """

    folder: Path
    shard: Shard
    request: Mapping[str, Any]
    facts: Mapping[str, str]

    @cached_property
    def answers(self) -> Sequence[MachineAnswer]:
        """The answers to what every shard asks."""
        return [one.answer for one in read_sentinels(self.folder)]


_Stored = TypeVar("_Stored", bound=StoredShard)


def all_shards(shards: Sequence[_Stored]) -> list[_Stored]:
    """Return shards in order; raises InputError unless they are all of one request, each given once."""
    times_given = Counter(shard.folder.resolve() for shard in shards)
    if twice := [folder for folder, times in times_given.items() if times > 1]:
        raise InputError(f"{twice[0]}: is given twice")
    first, *others = shards
    faults = [*_division_faults(shards), *(fault for one in others for fault in _request_faults(one, first))]
    if faults:
        raise InputError("\n".join(faults))
    return sorted(shards, key=lambda one: one.shard.index)


def machine_findings(shards: Sequence[StoredShard]) -> list[str]:
    """Return in which facts the machines differ, and which sentinels have other bits on some of them."""
    return [
        *differing_facts({str(one.shard): one.facts for one in shards}),
        *disagreements({str(one.shard): one.answers for one in shards}),
    ]


def _division_faults(shards: Sequence[StoredShard]) -> Iterator[str]:
    """Yield which shards are missing, given twice, or of another division."""
    folders: dict[Shard, list[Path]] = {}
    for one in shards:
        folders.setdefault(one.shard, []).append(one.folder)
    if len({shard.count for shard in folders}) > 1:
        listed = ", ".join(f"{one.folder} is {one.shard}" for one in shards)
        yield f"shards of different divisions: {listed}"
        return
    for shard, same in folders.items():
        if len(same) > 1:
            yield f"{', '.join(map(str, same))}: all are shard {shard}"
    total = shards[0].shard.count
    absent = [str(Shard(k, total)) for k in range(1, total + 1) if Shard(k, total) not in folders]
    if absent:
        yield f"missing shard{'s' * (len(absent) > 1)}: {', '.join(absent)}"


def _request_faults(one: StoredShard, first: StoredShard) -> Iterator[str]:
    """Yield in what the request of a shard differs from that of the first."""
    for name in first.request:
        if name in one.request and one.request[name] != first.request[name]:
            values = f"{name} is {one.request[name]}, but {first.request[name]} in"
            shown = values if len(values) <= _LONGEST else f"has another {name} than"
            yield f"{one.folder}: {shown} {first.folder}"
