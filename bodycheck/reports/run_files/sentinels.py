"""Sentinels: the cases that every shard of a run repeats, which show whether the machines agree."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import setting
from bodycheck._util.untrusted import escaped, no_formula
from bodycheck.adapters.contract import Build, Engine, Method, Setting
from bodycheck.adapters.execution import Answer
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.run_files.tables import open_csv
from bodycheck.reports.run_files.trajectory_files import npz, read_arrays, stored_arrays

_COLUMNS = (
    "scenario",
    "engine",
    "engine_version",
    "method",
    "setting",
    "outcome",
    "message",
    "build",
    "file",
)
_TABLE, _FOLDER = "sentinels.csv", "sentinels"


class MachineAnswer(NamedTuple):
    """What an engine answered on one machine; arrays: by quantity, {} for none."""

    name: str
    engine_version: str
    outcome: str
    arrays: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Sentinel:
    """The answer of one machine to a case that every shard runs; setting: its step or tolerance as text."""

    scenario: str
    engine: str
    engine_version: str
    method: str
    setting: str
    outcome: str
    message: str
    build: str
    trajectory: Trajectory | None

    @classmethod
    def of(cls, scenario: str, engine: Engine, method: Method, at: Setting, answer: Answer) -> Sentinel:
        """Return the sentinel of an engine's answer."""
        setting_text = setting(method.control, at.fineness)
        build, motion = Build(answer.build).short, answer.trajectory
        identity = scenario, engine.name, engine.version, method.name
        return cls(*identity, setting_text, answer.outcome, answer.message, build, motion)

    @property
    def answer(self) -> MachineAnswer:
        """The answer, under the case as text."""
        name = f"{self.engine}:{self.method} on {self.scenario}, {self.setting}"
        arrays = {} if self.trajectory is None else stored_arrays(self.trajectory)
        return MachineAnswer(name, self.engine_version, self.outcome, arrays)


def write_sentinels(sentinels: Sequence[Sentinel], folder: Path) -> None:
    """Write sentinels.csv, and each motion into sentinels/; nothing where there is none."""
    if not sentinels:
        return
    (folder / _FOLDER).mkdir()
    with (folder / _TABLE).open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(_COLUMNS)
        for index, one in enumerate(sentinels):
            name = "" if one.trajectory is None else f"{index:04d}.npz"
            rows.writerow([*(no_formula(getattr(one, column)) for column in _COLUMNS[:-1]), name])
            if one.trajectory is not None:
                (folder / _FOLDER / name).write_bytes(npz(stored_arrays(one.trajectory)))


def read_sentinels(folder: Path) -> tuple[Sentinel, ...]:
    """Read the sentinels of a run; none where it has no sentinels.csv. Raises InputError if damaged."""
    path = folder / _TABLE
    if not path.exists():
        return ()
    with open_csv(path) as lines:
        head, rows = next(lines, []), list(lines)
    if tuple(head) != _COLUMNS or any(len(row) != len(_COLUMNS) for row in rows):
        raise InputError(f"{path}: not a table of sentinels (expected the columns {', '.join(_COLUMNS)})")
    return tuple(_sentinel(folder, row) for row in rows)


def _sentinel(folder: Path, row: Sequence[str]) -> Sentinel:
    cells = dict(zip(_COLUMNS, map(escaped, row), strict=True))
    file = cells.pop("file")
    if not file:
        return Sentinel(**cells, trajectory=None)
    path = folder / _FOLDER / Path(file).name
    arrays = read_arrays(path)
    try:
        return Sentinel(**cells, trajectory=Trajectory(**arrays))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: not the trajectory of a sentinel: {error}") from None


def machine_facts(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return the facts of a manifest about a machine and its software that may affect results, by name."""
    facts = {name: str(manifest[name]) for name in ("python", "bodycheck", "cpu", "cores", "platform")}
    return facts | manifest["libraries"]


def differing_facts(facts: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Yield each fact in which shards differ, with its values and the shards that have them.

    facts: name -> value, by the name of the shard.
    """
    for name in dict.fromkeys(name for each in facts.values() for name in each):
        shards: dict[str, list[str]] = {}
        for shard, each in facts.items():
            shards.setdefault(each.get(name, "none"), []).append(shard)
        if len(shards) > 1:
            values = (
                f"{value} in shard{'s' * (len(those) > 1)} {', '.join(those)}"
                for value, those in shards.items()
            )
            yield f"shards differ in {name}: {'; '.join(values)}"


def disagreements(answers: Mapping[str, Sequence[MachineAnswer]]) -> list[str]:
    """Return a sentence for each answer that has not the same bits on all machines.

    answers: those of each shard by the shard's name. A shard without an answer lacks the engine.
    """
    by_name: dict[str, dict[str, MachineAnswer]] = {}
    for shard, each in answers.items():
        for answer in each:
            by_name.setdefault(answer.name, {})[shard] = answer
    return [found for same in by_name.values() if (found := _disagreement(same))]


def _disagreement(answers: Mapping[str, MachineAnswer]) -> str:
    """Return how the answers to one case differ, grouped by equal answers; empty where they do not."""
    groups: list[dict[str, MachineAnswer]] = []
    for shard, answer in answers.items():
        same = (group for group in groups if _is_same(next(iter(group.values())), answer))
        group = next(same, None)
        if group is None:
            groups.append(group := {})
        group[shard] = answer
    if len(groups) < 2:
        return ""
    first, *others = groups
    reference = next(iter(first.values()))
    differences = (f"{_shards(group)} {_against(reference, next(iter(group.values())))}" for group in others)
    return f"{reference.name}: compared with {_shards(first)}, {'; '.join(differences)}"


def _shards(group: Mapping[str, MachineAnswer]) -> str:
    return f"shard{'s' * (len(group) > 1)} {', '.join(group)}"


def _is_same(a: MachineAnswer, b: MachineAnswer) -> bool:
    return a.outcome == b.outcome and not _differences(a.arrays, b.arrays)


def _against(a: MachineAnswer, b: MachineAnswer) -> str:
    version = (
        ""
        if a.engine_version == b.engine_version
        else f" (version {b.engine_version}, not {a.engine_version})"
    )
    if a.outcome != b.outcome or not a.arrays or not b.arrays:
        return f"ended {b.outcome}, not {a.outcome}{version}"
    digits = _differences(a.arrays, b.arrays)
    worst = min(digits, key=lambda name: digits[name])
    return f"agrees to {max(digits[worst], 0.0):.1f} digits, the least in {worst}{version}"


def _differences(one: Mapping[str, Array], other: Mapping[str, Array]) -> dict[str, float]:
    """Return -log10(max |a - b| / max |a|) of each quantity that has not the same bits in both."""
    return {
        name: _digits(one.get(name), other.get(name))
        for name in {**one, **other}
        if name not in one or name not in other or not np.array_equal(one[name], other[name], equal_nan=True)
    }


def _digits(a: Array | None, b: Array | None) -> float:
    if a is None or b is None or a.shape != b.shape:
        return 0.0
    with np.errstate(all="ignore"):
        gap, size = float(np.max(np.abs(a - b))), float(np.max(np.abs(a)))
        return -math.log10(gap / size) if 0.0 < gap < math.inf and 0.0 < size < math.inf else 0.0
