"""Merge the shards of an ensemble: the union of their rows, and how their machines differ."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AliasChoices, AliasPath, BaseModel, Field, ValidationError

from bodycheck._util.errors import InputError
from bodycheck._util.shard import Shard
from bodycheck._util.untrusted import escaped, read_json
from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.ensembles.ensemble_files import PART, add_stored_rows, write_summaries
from bodycheck.ensembles.ensemble_result import EnsembleRequest, EnsembleResult, Key
from bodycheck.reports.run_files.method_words import OTHER_BITS, SAME_BITS
from bodycheck.reports.run_files.sentinels import machine_facts
from bodycheck.reports.run_files.writer import atomic_folder
from bodycheck.runs.shards import StoredShard, all_shards, machine_findings

_OF_THE_MACHINE = ("shard", "jobs", "timeout_s", "allow_code")


class _Method(BaseModel):
    """One of the entry `methods` of a shard's manifest."""

    engine: str
    version: str
    method: dict[str, Any]
    dt_s: float | None
    tolerance: float | None
    replay: Annotated[
        Literal["", "same bits", "other bits"],
        Field(validation_alias=AliasChoices("replay", AliasPath("statistics", "replay"))),
    ]

    @property
    def identity(self) -> tuple[Any, ...]:
        """Engine, method and setting, as in the tables."""
        return self.engine, self.method["name"], self.dt_s, self.tolerance


class _Manifest(BaseModel):
    """What merging needs of the manifest of a shard."""

    python: str
    bodycheck: str
    cpu: str
    cores: int | None
    platform: str
    libraries: dict[str, str]
    request: EnsembleRequest
    distribution: dict[str, Any]
    methods: list[_Method]


@dataclass(frozen=True, eq=False)
class _Part(StoredShard):
    """A shard with its manifest."""

    manifest: _Manifest


def merge_ensembles(folders: Sequence[Path], out: Path, *, allow_code: bool = False) -> EnsembleResult:
    """Write the ensemble that these shards are parts of to `out`, and return its statistics.

    allow_code: the scenario may name functions. Raises InputError where a folder is not a shard, a shard is
    missing or given twice, or the shards are not of one request.
    """
    parts = all_shards([_part(folder) for folder in folders])
    result = _merged(parts, allow_code=allow_code)
    with atomic_folder(out) as folder:
        for table in ("bodies", "cases"):
            _concatenate([part.folder / table for part in parts], folder / table)
        write_summaries(result, folder, out)
    return result


def _part(folder: Path) -> _Part:
    path = folder / "manifest.json"
    try:
        manifest = _Manifest.model_validate(read_json(path))
        if manifest.request.shard is None:
            raise InputError(f"{folder}: a whole ensemble (expected a folder written with --shard)")
        same = {
            **{name: value for name, value in vars(manifest.request).items() if name not in _OF_THE_MACHINE},
            "distribution": manifest.distribution,
            "methods": [method.identity for method in manifest.methods],
        }
        facts = machine_facts(manifest.model_dump()) | {one.engine: one.version for one in manifest.methods}
        return _Part(folder, Shard.parse(manifest.request.shard), same, facts, manifest)
    except FileNotFoundError:
        raise InputError(f"{path}: missing: not a folder of `bodycheck ensemble`") from None
    except ValidationError as error:
        fault = error.errors()[0]
        location = ".".join(map(str, fault["loc"]))
        raise InputError(
            escaped(f"{path}: not of a shard of an ensemble: {location}: {fault['msg']}")
        ) from None


def _merged(parts: Sequence[_Part], *, allow_code: bool) -> EnsembleResult:
    request = replace(parts[0].manifest.request, shard=None, allow_code=allow_code)
    methods_of_shards = list(zip(*(part.manifest.methods for part in parts), strict=True))
    result = EnsembleResult.empty(request, request.ensemble(), list(map(_key, methods_of_shards)))
    for part in parts:
        add_stored_rows(result, part.folder, part.manifest.request.rows)
    for (_, statistics), methods in zip(result.statistics, methods_of_shards, strict=True):
        replays = {one.replay for one in methods}  # an unknown one, "", makes that of the whole unknown
        statistics.replay = next(replay for replay in (OTHER_BITS, "", SAME_BITS) if replay in replays)
    shards = tuple(str(part.shard) for part in parts)
    return replace(result, shards=shards, findings=tuple(machine_findings(parts)))


def _key(methods: Sequence[_Method]) -> Key:
    """Return a method of all shards; an engine in several versions has all of them as its version."""
    first, method = methods[0], Method.of(methods[0].method)
    versions = " and ".join(dict.fromkeys(one.version for one in methods))
    return Engine(first.engine, versions, {method.name: method}), method, Setting(first.dt_s, first.tolerance)


def _concatenate(tables: Sequence[Path], target: Path) -> None:
    """Copy the files of a table of all shards, numbered in the order of the shards."""
    numbers: Counter[Path] = Counter()
    for table in tables:
        for folder in {file.parent for file in table.rglob(PART.format("*"))}:
            whole = target / folder.relative_to(table)
            whole.mkdir(parents=True, exist_ok=True)
            for number in range(len(list(folder.glob(PART.format("*"))))):
                shutil.copyfile(folder / PART.format(number), whole / PART.format(numbers[whole]))
                numbers[whole] += 1
