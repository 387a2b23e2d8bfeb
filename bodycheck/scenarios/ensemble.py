"""Ensembles: random bodies and initial states in place of a scenario's, each determined by seed and row."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.random_bodies import COORDINATES, Bodies, Distribution, bodies_at
from bodycheck.reference_impl.scene import Scene
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_members
from bodycheck.scenarios.serialization import serialized

TRACE_KG_M2 = (1e-9, 1e3)
"""Range of I1 + I2 + I3 where nothing acts on the body: from a coin to a satellite."""

_SPREAD = 10.0  # of the default spins, below and above that of the scenario
_WORDS = len(COORDINATES)
_BLOCK = 4  # words per increment of the counter of Philox
_ROWS = 2**60
_COPIED_KEYS = ("mass_kg", "link_offset_m", "link_quaternion")  # of the body


def default_distribution(
    scenario: Scenario,
    trace_kg_m2: tuple[float, float] | None = None,
    spin_rad_s: tuple[float, float] | None = None,
    torque_n_m: tuple[float, float] | None = None,
    *,
    spread: float = _SPREAD,
) -> Distribution:
    """Return the ranges, with those of the scenario where one is None.

    Spins reach from 1 / spread to spread times that of the scenario, or are about 1 rad/s for one at rest.
    The trace is that of the scenario where a load acts, so that load and body stay in proportion.
    """
    scene = scenario.scene
    spin = float(np.linalg.norm(scene.initial.omega_body)) or 1.0
    trace = float(np.trace(scene.body.inertia))
    if trace_kg_m2 is None:
        trace_kg_m2 = TRACE_KG_M2 if scene.is_free_rotation and torque_n_m is None else (trace, trace)
    return Distribution(trace_kg_m2, spin_rad_s or (spin / spread, spin * spread), torque_n_m or (0.0, 0.0))


@dataclass(frozen=True)
class Ensemble:
    """A scenario whose body and initial rotation are drawn for each row.

    Row k of a seed is made of the words 12 k to 12 k + 11 of the counter-based generator Philox (Salmon,
    Moraes, Dror and Shaw (2011), Parallel random numbers: as easy as 1, 2, 3) with the seed as its key:
    it needs no other row.
    """

    scenario: Scenario
    distribution: Distribution
    seed: int
    samples: int

    @property
    def template(self) -> Scene:
        """The scene of the scenario, at the samples of the ensemble."""
        return replace(self.scenario.scene, samples=self.samples)

    def points(self, first: int, end: int) -> Array:
        """Return the points of the unit cube (end - first, 12) of these rows, neither 0 nor 1."""
        counter = first * (_WORDS // _BLOCK)
        words = np.random.Philox(key=self.seed, counter=counter).random_raw((end - first) * _WORDS)
        shares = (np.asarray(words >> 11, dtype=np.float64) + 0.5) * 2.0**-53
        return np.asarray(shares.reshape(-1, _WORDS), dtype=np.float64)

    def bodies(self, first: int, end: int) -> Bodies:
        """Return the bodies of these rows."""
        return bodies_at(self.distribution, self.points(first, end))

    def row_scenario(self, row: int) -> Scenario:
        """Return one row as a scenario of its own."""
        check_row(row)
        summary = f"row {row} of the ensemble of {self.scenario.name} with seed {self.seed}"
        name = f"{self.scenario.name}-seed-{self.seed}-row-{row}"
        return self.scenario_of(self.bodies(row, row + 1), name, summary, "bodycheck ensemble")

    def scenario_of(self, bodies: Bodies, name: str, summary: str, source: str) -> Scenario:
        """Return the scenario with the first of these bodies; source: the command that found them."""
        data = serialized(self.scenario)
        initial = {key: data["initial"][key] for key in ("position_m",) if key in data["initial"]}
        if self.scenario.scene.pivot is None and "velocity_m_s" in data["initial"]:
            initial["velocity_m_s"] = data["initial"]["velocity_m_s"]
        body = {key: data["body"][key] for key in _COPIED_KEYS if key in data["body"]}
        forcing = list(data.get("forcing", ()))
        if bodies.torque_body[0].any():
            forcing.append({"kind": "torque", "axes": "body", "value_n_m": bodies.torque_body[0].tolist()})
        made = {
            "name": name.replace("/", "-"),
            "summary": summary,
            "source": source,
            "tags": list(data["tags"]),
            "duration_s": data["duration_s"],
            "samples": self.samples,
            "body": {**body, "inertia_kg_m2": bodies.moments[0].tolist()},
            "initial": {
                **initial,
                "quaternion": bodies.quaternion[0].tolist(),
                "omega_body_rad_s": bodies.omega_body[0].tolist(),
            },
            "forcing": forcing,
        }
        text = toml_text(made)
        return next(iter(parse_members(text, where=name, folder=Path(), allow_code=True).values()))


def check_row(row: int) -> None:
    """Raise InputError for a row that no ensemble has."""
    if not 0 <= row < _ROWS:
        raise InputError(f"--row {row}: must be from 0 to {_ROWS - 1}")


def scenario_text(scenario: Scenario) -> str:
    """Return a scenario with a body given by numbers as a TOML file."""
    return toml_text(serialized(scenario))


def toml_text(data: Mapping[str, Any]) -> str:
    """Return plain data as TOML: keys, then tables, then lists of tables, each of keys only."""
    return "\n".join(_lines(data)) + "\n"


def _lines(data: Mapping[str, Any]) -> Iterator[str]:
    tables = {key: value for key, value in data.items() if isinstance(value, Mapping)}
    lists = {key: value for key, value in data.items() if _is_list_of_tables(value)}
    for key, value in data.items():
        if key not in tables and key not in lists and value != []:
            yield f"{key} = {_value(value)}"
    for key, table in tables.items():
        if table:
            yield from ("", f"[{key}]", *(f"{name} = {_value(value)}" for name, value in table.items()))
    for key, rows in lists.items():
        for table in rows:
            yield from ("", f"[[{key}]]", *(f"{name} = {_value(value)}" for name, value in table.items()))


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and isinstance(value[0], Mapping)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # which only TOML forbids
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(part) for part in value)}]"
    return repr(value)
