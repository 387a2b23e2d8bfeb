"""manifest.json: a run's id, versions, machine, settings and scenarios."""

from __future__ import annotations

import os
import platform
import secrets
import subprocess
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bodycheck._util.platform_identity import cpu_model
from bodycheck._util.source_commit import source_commit
from bodycheck.adapters.contract import Engine
from bodycheck.adapters.registry import requested_name
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.runs.request import Request
from bodycheck.runs.selection import Selection
from bodycheck.runs.speed import MachineNoise
from bodycheck.scenarios.serialization import serialized

_GIT_S = 10.0  # at most, for a command of git


@dataclass(frozen=True)
class Identity:
    """The id of a run and the time at which it started; a resumed run keeps both."""

    run_id: str
    created: datetime

    @classmethod
    def new(cls) -> Identity:
        """Return a unique id with the present time."""
        created = datetime.now(UTC)
        return cls(f"{created:%Y%m%dT%H%M%SZ}-{secrets.token_hex(3)}", created)


def _engine(engine: Engine, cases: Sequence[CaseResult]) -> dict[str, Any]:
    """Return an engine's version and build as announced, and the builds that computed its cases."""
    columns = (case.columns for case in cases if case.columns["engine"] == engine.name)
    builds = sorted({row["build"] for row in columns if row.get("build")})
    found = {"version": engine.version, "build": asdict(engine.build), "builds": builds, "methods": {}}
    command = requested_name(engine.name)
    return found if command == engine.name else {**found, "command": command}


def manifest_of(
    identity: Identity,
    selection: Selection,
    options: Request,
    cases: Sequence[CaseResult],
    seconds: Mapping[str, float],
    noise: MachineNoise | None,
) -> dict[str, Any]:
    """Return the manifest of a run as plain data."""
    engines: dict[str, Any] = {name: {"unavailable": why} for name, why in selection.unavailable.items()}
    for engine, method in selection.methods:
        entry = engines.setdefault(engine.name, _engine(engine, cases))
        entry["methods"][method.name] = asdict(method)
    return {
        "run_id": identity.run_id,
        "created": identity.created.isoformat(timespec="seconds"),
        **software(),
        "commit": commit(),
        "source": source_commit(options.commit),
        **(machine() if options.timing is None else options.timing.machine),
        "engines": engines,
        "dt_s": selection.dt_s,
        "tolerances": selection.tolerances,
        "speed": options.speed,
        "jobs": options.workers,
        "timeout_s": options.timeout_s,
        "request": options.data,
        "speed_core": noise.core if noise else None,
        "speed_noise": noise.spread if noise else None,
        "outcomes": dict(Counter(case.columns["outcome"] for case in cases)),
        "scenarios": {s.name: serialized(s) for _, s in selection.scenarios},
        **seconds,
        **({} if selection.full is None else {"shard": _shard(selection, selection.full)}),
    }


def _shard(selection: Selection, full: Selection) -> dict[str, Any]:
    """Return which shard a run is, and of what: all scenarios and methods, in order."""
    return {
        "shard": str(selection.shard),
        "scenarios": {scenario.name: scenario_spec for scenario_spec, scenario in full.scenarios},
        "methods": [[engine.name, method.name] for engine, method in full.methods],
        "off_centre_only": sorted(map(list, full.off_centre_only)),
    }


def software() -> dict[str, Any]:
    """Return the versions of bodycheck, Python and the libraries that compute."""
    return {
        "bodycheck": version("bodycheck"),
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in ("numpy", "numba", "scipy", "pandas")},
    }


def machine() -> dict[str, Any]:
    """Return the facts of this machine."""
    return {
        "platform": platform.platform(),
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
    }


def commit() -> str | None:
    """Return the commit of the git checkout that this package is part of, with "+" if it is modified."""
    package = Path(__file__).parents[1]
    # the settings of another checkout, which this package may be installed in, can make git start programs
    if not (package.parent / ".git").exists():
        return None
    try:
        if not _git(package, "ls-files", "__init__.py"):
            return None
        return _git(package, "rev-parse", "--short=10", "HEAD") + "+" * bool(
            _git(package, "status", "--porcelain", "--untracked-files=no", ".")
        )
    except (OSError, subprocess.SubprocessError):
        return None


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=_GIT_S, check=True
    )
    return done.stdout.strip()
