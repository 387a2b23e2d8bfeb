"""Every kind of load, and every key of its table, has an effect, in whatever unit of time it is given."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, Key, KeyForm, Load
from bodycheck.reference_impl.rotations import exp_matrix
from bodycheck.reference_impl.scene import RigidBody, Scene, State

VALUES: Mapping[KeyForm, Any] = {
    "number": 0.7,
    "positive": 0.7,
    "not negative": 0.3,
    "vector": np.array([0.4, -0.9, 0.6]),
    "damping matrix": np.array([[0.5, 0.1, 0.0], [-0.2, 0.4, 0.1], [0.0, 0.3, 0.6]]),
}
"""A value of each form of a key but axes."""

INTERVALS = {"from_s": (-np.inf, -1.0), "until_s": (np.inf, 1.0)}
"""A value of a key with which the load always acts, and another one."""

SCENE = Scene(
    RigidBody(1.3, np.diag([2.0, 2.5, 3.0])),
    State(
        np.array([0.3, -0.2, 0.1]), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.9, 1.3, -0.8])
    ),
    (),
    np.zeros(3),
    duration_s=1.0,
    samples=2,
)
AT = Instants(
    t=np.array(0.6),
    position=np.array([1.1, 0.4, -0.7]),
    rotation=exp_matrix(np.array([0.5, -0.3, 0.8])),
    velocity=np.array([0.2, -0.5, 0.3]),
    omega=np.array([0.7, 0.2, -1.1]),
)


def sample_of(kind: type[Load], axes: str) -> Load:
    """Return a load with a value of each key."""
    values = {
        name: axes if key.form == "axes" else INTERVALS.get(key.name, (VALUES.get(key.form),))[0]
        for name, key in kind.keys().items()
    }
    return kind(**values)


def wrench_of(load: Load) -> Array:
    """Return force and torque (6,) of a load."""
    return np.concatenate([np.broadcast_to(part, 3) for part in load.wrench(SCENE, AT)])


def inert_entries(kinds: Iterable[type[Load]]) -> list[str]:
    """Return what has no effect: kinds without force and torque, and keys that change neither."""
    found = []
    for kind in kinds:
        samples = [sample_of(kind, axes) for axes in ("body", "world")]
        if not any(wrench_of(load).any() for load in samples):
            found.append(f"{kind.kind}: neither force nor torque")
            continue
        for name, key in kind.keys().items():
            if key.name in INTERVALS:  # the steppers hold these loads; their formula does not know the time
                continue
            if key.form == "axes":
                pairs = [tuple(samples)]
            else:
                changed = 1.5 * np.asarray(getattr(samples[0], name))
                value = changed if changed.ndim else float(changed)
                pairs = [(load, replace(load, **{name: value})) for load in samples]  # type: ignore[type-var]
            if all(np.array_equal(wrench_of(one), wrench_of(other)) for one, other in pairs):
                found.append(f"{kind.kind}: the key {key.name} changes nothing")
    return found


def without_units(kinds: Iterable[type[Load]]) -> list[str]:
    """Return the keys whose power of the second is missing, or is not that of the formula."""
    found = []
    unit = 2.0**3
    faster = replace(AT, t=AT.t / unit, velocity=AT.velocity * unit, omega=AT.omega * unit)
    for kind in kinds:
        missing = [key.name for key in kind.keys().values() if key.form != "axes" and key.seconds is None]
        found += [f"{kind.kind}: Key({name!r}) has no seconds" for name in missing]
        for axes in ("body", "world"):
            load = sample_of(kind, axes)
            other = load.in_time_unit(3)
            if other is None:
                continue
            expected = [unit**2 * part for part in load.wrench(SCENE, AT)]
            if not all(map(np.array_equal, expected, other.wrench(SCENE, faster))):
                found.append(f"{kind.kind}: the seconds of its keys are not those of its formula")
                break
    return found


KINDS = [kind for name, kind in load_kinds().items() if name != "callable"]


def test_every_kind_of_load_and_every_key_has_an_effect() -> None:
    """Force or torque is not zero, and changes with each constant."""
    assert inert_entries(KINDS) == []


def test_every_key_has_the_power_of_the_second_in_its_unit() -> None:
    """In a unit of time of 8 s, force and torque are 64 times as large, to the last bit."""
    assert without_units(KINDS) == []


@dataclass(frozen=True, eq=False)
class Swirl(ContinuousLoad):
    """tau = c omega, with a second constant that is forgotten."""

    kind: ClassVar[str] = "swirl"
    swirl: Annotated[float, Key("swirl_n_m_s", "positive", seconds=-1)]
    forgotten: Annotated[float, Key("forgotten_m", "positive", seconds=0)]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:  # noqa: ARG002 - the interface
        """Return no force, and the torque."""
        return np.zeros(3), self.swirl * at.omega


class Nothing(Swirl):
    """No force and no torque."""

    kind: ClassVar[str] = "nothing"

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:  # noqa: ARG002 - the interface
        """Return zeros."""
        return np.zeros(3), np.zeros(3)


@dataclass(frozen=True, eq=False)
class Unitless(Swirl):
    """The same with wrong and missing units."""

    kind: ClassVar[str] = "unitless"
    swirl: Annotated[float, Key("swirl_n_m_s", "positive", seconds=-2)]


@pytest.mark.parametrize(
    ("kind", "named"),
    [(Swirl, "swirl: the key forgotten_m changes nothing"), (Nothing, "nothing: neither force nor torque")],
)
def test_an_inert_load_is_named(kind: type[Load], named: str) -> None:
    """The check of the built-in kinds names what does nothing."""
    assert inert_entries([kind]) == [named]


def test_a_wrong_unit_is_named() -> None:
    """A scene with the load would be solved as another one in another unit of time."""
    assert without_units([Swirl]) == []
    assert without_units([Unitless]) == ["unitless: the seconds of its keys are not those of its formula"]
