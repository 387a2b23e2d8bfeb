"""manifest.json: a run's id, versions, machine, settings and scenarios."""

from __future__ import annotations

import os
import platform
import secrets
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bodycheck.adapters.contract import Engine
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.speed import MachineNoise
from bodycheck.runs.run_options import RunOptions
from bodycheck.runs.selection import Selection
from bodycheck.scenarios.serialization import written


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
    return {"version": engine.version, "build": asdict(engine.build), "builds": builds, "methods": {}}


def manifest_of(
    identity: Identity,
    selection: Selection,
    options: RunOptions,
    cases: Sequence[CaseResult],
    seconds: Mapping[str, float],
    quietness: MachineNoise | None,
) -> dict[str, Any]:
    """Return the manifest of a run as plain data."""
    engines: dict[str, Any] = {name: {"unavailable": why} for name, why in selection.unavailable.items()}
    for engine, method in selection.methods:
        entry = engines.setdefault(engine.name, _engine(engine, cases))
        entry["methods"][method.name] = asdict(method)
    return {
        "run_id": identity.run_id,
        "created": identity.created.isoformat(timespec="seconds"),
        "bodycheck": version("bodycheck"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "libraries": {name: version(name) for name in ("numpy", "numba", "scipy", "pandas")},
        "engines": engines,
        "dt_s": selection.dt_s,
        "tolerances": selection.tolerances,
        "speed": options.speed,
        "jobs": options.workers,
        "timeout_s": options.timeout_s,
        "speed_core": quietness.core if quietness else None,
        "speed_noise": quietness.spread if quietness else None,
        "outcomes": dict(Counter(case.columns["outcome"] for case in cases)),
        "scenarios": {s.name: written(s) for _, s in selection.scenarios},
        **seconds,
    }


def cpu_model() -> str:
    """Return the processor's name from /proc/cpuinfo, or from Python where that does not exist."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
