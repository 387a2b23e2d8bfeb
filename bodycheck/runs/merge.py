"""Merge the shards of a run: the union of their tables and motions, and how their machines differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import count
from bodycheck._util.shard import Shard
from bodycheck._util.untrusted import shell_quote
from bodycheck.adapters.contract import Build, Engine, Method
from bodycheck.adapters.engine_names import with_method
from bodycheck.adapters.execution import Answer
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.comparison.environment_diff import simulated
from bodycheck.reports.history.baseline import machine_class
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.case_columns import SPEEDS
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.study import Study, study
from bodycheck.reports.run_files.method_words import identified
from bodycheck.reports.run_files.run_reader import read_manifest, read_run
from bodycheck.reports.run_files.run_tables import Run, key_of, study_key
from bodycheck.reports.run_files.sentinels import machine_facts
from bodycheck.reports.run_files.tables import TABLES, Row
from bodycheck.runs.directory import partial_of
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import undivided
from bodycheck.runs.selection import Selection
from bodycheck.runs.shards import StoredShard, all_shards, machine_findings

_REQUESTED = ("dt_s", "tolerances", "speed")
_SECONDS = ("compile_s", "truths_s", "motions_s", "speeds_s", "run_s")


class _ShardFacts(BaseModel):
    """The entry `shard` of a manifest."""

    shard: str
    scenarios: dict[str, str]
    methods: list[tuple[str, str]]
    off_centre_only: list[tuple[str, str]]


@dataclass(frozen=True, eq=False)
class _Part(StoredShard):
    """A shard of a run: its manifest, and what is read once all shards are known to belong together."""

    manifest: dict[str, Any]
    allow_code: bool

    @cached_property
    def run(self) -> Run:
        return read_run(self.folder, allow_code=self.allow_code, cache=Cache.default())

    @property
    def machine(self) -> str:
        return machine_class(self.manifest)


def merge(folders: Sequence[Path], *, allow_code: bool = False) -> Run:
    """Return the run that these shards are parts of; `manifest["merged"]` has the shards and the findings.

    Each shard's rows are taken as they are. A case whose shard lacks its engine is `failed`. Speeds are those
    of one class of machines, the one that timed the most cases. allow_code: scenarios may name functions.

    Raises InputError where a folder is not a complete shard, a shard is missing or given twice, or the
    shards are not of one request.
    """
    parts = all_shards([_part(folder, allow_code) for folder in folders])
    try:
        selection = _selection(parts)
    except (KeyError, TypeError) as error:
        raise _inconsistent(error) from None
    identity = Identity.new()
    timed_on = _timed_on(parts)
    cases = [
        case if part.machine == timed_on else _untimed(case) for part in parts for case in part.run.cases
    ]
    names = [name for name in TABLES if name != "results"]
    rows: dict[str, list[Row]] = {
        name: [row for part in parts for row in part.run.rows(name)] for name in names
    }
    problems = {problem.scenario.name: problem for part in parts for problem in part.run.problems}
    measured = {study_key(case.columns) for case in cases}
    missing: list[str] = []
    for _, scenario in selection.scenarios:
        for engine, method in selection.methods:
            key = scenario.name, engine.name, method.name
            if key not in measured and selection.runs_on(scenario, engine, method):
                missing.append(with_method(engine.name, method.name))
                owner = parts[Shard(1, len(parts)).owner("study", *key) - 1]
                failed_study = _failed_study(selection, problems[scenario.name], engine, method, owner)
                cases += failed_study.cases
                rows["methods"] += failed_study.method_rows
    places = {scenario.name: place for place, (_, scenario) in enumerate(selection.scenarios)}
    method_places = {(e.name, m.name): place for place, (e, m) in enumerate(selection.methods)}

    def place_of(row: Mapping[str, Any]) -> tuple[int, int]:
        try:
            return places[row["scenario"]] if "scenario" in row else 0, method_places[key_of(row)]
        except KeyError as error:
            raise _inconsistent(error) from None

    for table in rows.values():
        table.sort(key=place_of)
    # a shard examines some of the methods only
    rows["methods"] = list(identified(rows["methods"], rows["fingerprints"], rows["laws"]))
    cases.sort(key=lambda case: place_of(case.columns))
    own_id = {"run_id": identity.run_id}
    return Run(
        run_id=identity.run_id,
        manifest=_manifest(identity, parts, selection, cases, timed_on, missing),
        problems=tuple(problems[name] for name in places),
        cases=tuple(cases),
        tables={name: [{**row, **own_id} for row in table] for name, table in rows.items()},
    )


def _inconsistent(error: Exception) -> InputError:
    return InputError(f"the manifests of the shards are inconsistent: {error!r}")


def _part(folder: Path, allow_code: bool) -> _Part:
    """Return the shard that a folder holds."""
    unfinished = partial_of(folder)
    if unfinished.exists() and not folder.exists():
        resume = f"bodycheck run --resume {shell_quote(str(folder))}"
        raise InputError(f"{folder}: an interrupted shard; continue with: {resume}")
    manifest = read_manifest(folder)
    try:
        facts = _ShardFacts.model_validate(manifest.get("shard"))
    except ValidationError:
        raise InputError(
            f"{folder}: not a shard (expected a folder written by `bodycheck run --shard`)"
        ) from None
    versions = {name: entry.get("version", "unavailable") for name, entry in manifest["engines"].items()}
    same = {
        **undivided(_requested(manifest)),
        "scenarios": list(facts.scenarios),
        **{f"scenario {name}": simulated(content) for name, content in manifest["scenarios"].items()},
    }
    machine = machine_facts(manifest) | versions
    return _Part(folder, Shard.parse(facts.shard), same, machine, manifest, allow_code)


def _requested(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a shard was requested to do; the manifests of earlier versions have less of it."""
    return {**manifest.get("request", {}), **{key: manifest[key] for key in _REQUESTED}}


def _selection(parts: Sequence[_Part]) -> Selection:
    """Return what the shards have run together: scenarios and methods in their order."""
    known = {problem.scenario.name: problem for part in parts for problem in part.run.problems}
    names = list(parts[0].manifest["shard"]["scenarios"])
    entries = _engines(parts)
    engines = {n: _engine(n, entry) for n, entry in entries.items() if "unavailable" not in entry}
    pairs = dict.fromkeys(tuple(pair) for part in parts for pair in part.manifest["shard"]["methods"])
    first = parts[0].manifest
    only = {tuple(pair) for part in parts for pair in part.manifest["shard"]["off_centre_only"]}
    return Selection(
        scenarios=tuple((known[name].scenario_spec, known[name].scenario) for name in names if name in known),
        methods=tuple((engines[name], engines[name].methods[method]) for name, method in pairs),
        unavailable={n: entry["unavailable"] for n, entry in entries.items() if "unavailable" in entry},
        dt_s=first["dt_s"],
        tolerances=first["tolerances"],
        off_centre_only=frozenset(only),
    )


def _engine(name: str, entry: Mapping[str, Any]) -> Engine:
    methods = {method: Method.of(facts) for method, facts in entry["methods"].items()}
    return Engine(name, entry["version"], methods, Build(**entry.get("build", {})))


def _untimed(case: CaseResult) -> CaseResult:
    return replace(case, columns={k: v for k, v in case.columns.items() if k not in SPEEDS})


def _timed_on(parts: Sequence[_Part]) -> str:
    """Return the class of machines that timed the most cases."""
    timed = Counter({part.machine: 0 for part in parts})
    for part in parts:
        timed[part.machine] += sum("cpu_s" in case.columns for case in part.run.cases)
    return max(timed, key=lambda machine: timed[machine])


def _failed_study(
    selection: Selection, problem: Problem, engine: Engine, method: Method, owner: _Part
) -> Study:
    """Return the cases of a method that its shard did not have, as failed ones."""
    entry = owner.manifest["engines"].get(engine.name, {})
    why = entry.get(
        "unavailable", f"{engine.name} {entry.get('version', '')} has no such method".replace("  ", " ")
    )
    failed = Answer("failed", f"not run in shard {owner.shard}: {why}")
    settings = selection.settings(problem.scenario, engine, method)
    return study(
        problem,
        engine,
        method,
        settings,
        adaptive=False,
        ask=lambda engine, case: failed,  # noqa: ARG005 - the signature of RunCase
        search=None,
        case_done=lambda: None,
    )


def _manifest(
    identity: Identity,
    parts: Sequence[_Part],
    selection: Selection,
    cases: Sequence[CaseResult],
    timed_on: str,
    missing: Sequence[str],
) -> dict[str, Any]:
    """Return the manifest: machine and software of the first shard that speeds are from, engines of all."""
    source = next(part for part in parts if part.machine == timed_on).manifest
    noises = [p.manifest["speed_noise"] for p in parts if p.machine == timed_on and p.manifest["speed_noise"]]
    scenarios = {name: facts for part in parts for name, facts in part.manifest["scenarios"].items()}
    facts_of_shards = ("run_id", "created", "python", "platform", "bodycheck")
    shards = [
        {"shard": str(p.shard), "machine": p.machine, **{key: p.manifest[key] for key in facts_of_shards}}
        for p in parts
    ]
    findings = [
        *machine_findings(parts),
        *_rebuilt(parts),
        *(
            f"{name}: {count(amount, 'scenario')} not run, because the shard had no such method"
            for name, amount in Counter(missing).items()
        ),
        *_speed_finding(parts, timed_on),
    ]
    return {
        **{key: fact for key, fact in source.items() if key != "shard"},
        "run_id": identity.run_id,
        "created": identity.created.isoformat(timespec="seconds"),
        "request": {**_requested(source), "shard": None},
        "engines": _engines(parts),
        "speed_noise": max(noises, default=None),
        "outcomes": dict(Counter(case.columns["outcome"] for case in cases)),
        "scenarios": {scenario.name: scenarios[scenario.name] for _, scenario in selection.scenarios},
        **{key: sum(part.manifest[key] or 0.0 for part in parts) for key in _SECONDS},
        "merged": {"shards": shards, "findings": findings},
    }


def _engines(parts: Sequence[_Part]) -> dict[str, Any]:
    """Return the engines of all shards; an engine in several versions has all of them as its version."""
    found: dict[str, Any] = {}
    for part in parts:
        for name, entry in part.manifest["engines"].items():
            known = found.get(name)
            if known is None or ("unavailable" in known and "version" in entry):
                found[name] = dict(entry)
            elif "version" in entry and "version" in known:
                versions = dict.fromkeys([*known["version"].split(" and "), entry["version"]])
                known["version"] = " and ".join(versions)
                known["builds"] = sorted({*known.get("builds", ()), *entry.get("builds", ())})
                known["methods"] = {**entry["methods"], **known["methods"]}
    return found


def _speed_finding(parts: Sequence[_Part], timed_on: str) -> Iterator[str]:
    others = [part for part in parts if part.machine != timed_on]
    if others and parts[0].manifest["speed"]:
        left_out = ", ".join(str(part.shard) for part in others)
        yield f"speeds are those of {timed_on}; those of shards {left_out}, on other machines, are omitted"


def _rebuilt(parts: Sequence[_Part]) -> Iterator[str]:
    """Yield the engines of which shards have different builds, and the parts of the builds that differ."""
    names = dict.fromkeys(name for part in parts for name in part.manifest["engines"])
    for name in names:
        entries = [part.manifest["engines"].get(name, {}) for part in parts]
        builds = [entry["build"]["parts"] for entry in entries if "build" in entry]
        differing = sorted(
            {p for build in builds for p in build if any(build[p] != b.get(p) for b in builds)}
        )
        if differing:
            yield f"shards have different builds of {name}: {', '.join(differing)}"
