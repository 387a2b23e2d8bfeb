"""The trees of tests/oracles/joints.json, and the numbers that hold along their motions."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import mp, mpf

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene

_CASES = json.loads((Path(__file__).parents[1] / "oracles" / "joints.json").read_text("utf-8"))["cases"]
TREES = tuple(_CASES)


def tree(name: str) -> TreeScene:
    """Return the tree of a case."""
    case = _CASES[name]
    bodies = tuple(TreeBody(b["name"], b["mass"], np.array(b["inertia"]), _joint(b)) for b in case["bodies"])
    return TreeScene(bodies, (), np.array(case["gravity"]), case["times"][-1], 11)


def _joint(body: dict[str, Any]) -> Joint:
    return Joint(
        body["joint"],
        body["parent"],
        np.array(body["at_parent"]),
        np.array(body["at_child"]),
        np.array(body["zero"]),
        np.array(body.get("axis") or [0.0, 0.0, 1.0]),
        start=np.array(body["q0"]),
        rate=np.array(body["u0"]),
        stiffness=body["stiffness"],
        rest=body["rest"],
        damping=body["damping"],
    )


def times(name: str) -> Array:
    """Return the times of the numbers of a case, s."""
    return np.array([value["t"] for value in _CASES[name]["values"]])


@dataclass(frozen=True)
class Instant:
    """The 34-digit numbers at a time: q, u, and by the names of TreeDynamics, flattened."""

    q: list[mpf]
    u: list[mpf]
    values: dict[str, list[mpf]]


def instants(name: str) -> Iterator[Instant]:
    """Yield the numbers of a case at its times."""
    for value in _CASES[name]["values"]:
        yield Instant(
            _flat(value["q"]),
            _flat(value["u"]),
            {
                **{key: _flat(value[key]) for key in ("position", "velocity", "quaternion", "omega_body")},
                **{key: _flat([[value[key]]]) for key in ("kinetic", "potential")},
                "momentum": _flat([value["momentum"]]),
                "angular_momentum": _flat([value["angular_momentum_origin"]]),
            },
        )


def _flat(rows: list[list[str]]) -> list[mpf]:
    with mp.workdps(40):
        return [mpf(x) for row in rows for x in row]


def as_pair(numbers: list[mpf]) -> tuple[Array, Array]:
    """Return high and low parts of numbers."""
    with mp.workdps(40):
        high = np.array([float(x) for x in numbers])
        return high, np.array([float(x - mpf(h)) for x, h in zip(numbers, high, strict=True)])
