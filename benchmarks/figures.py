"""The figures that are measured, with their targets, and the result of a measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from benchmarks.timing import Spread

Verdict = Literal["pass", "miss", "not measured", ""]


@dataclass(frozen=True)
class Figure:
    """One number. at_most or at_least: its target, if it has one."""

    name: str
    what: str
    unit: str
    at_most: float | None = None
    at_least: float | None = None

    @property
    def target(self) -> str:
        """The target in words."""
        if self.at_most is not None:
            return f"<= {self.at_most:g}"
        return "" if self.at_least is None else f">= {self.at_least:g}"

    def verdict(self, value: float | None) -> Verdict:
        """Return whether a value meets the target. NaN does not."""
        if value is None:
            return "not measured"
        if self.at_most is not None:
            return "pass" if value <= self.at_most else "miss"
        if self.at_least is not None:
            return "pass" if value >= self.at_least else "miss"
        return ""


@dataclass(frozen=True)
class Measured:
    """The value of a figure, with its quartiles; None if it was not measured."""

    figure: str
    value: float | None
    low: float | None = None
    high: float | None = None
    note: str = ""

    @classmethod
    def of(cls, figure: str, spread: Spread, note: str = "") -> Measured:
        """Return a figure with the median and quartiles of a spread."""
        return cls(figure, spread.median, spread.low, spread.high, note)


def _forced() -> tuple[Figure, ...]:
    cost = "forced, 10 s, to 1e-12 rad: {}"
    floor = "least error on the way over 10 s, in eps x sensitivity: {}"
    targets = (
        ("constant body torque", 35.0),
        ("angular drag", 35.0),
        ("body sine torque", 35.0),
        ("gravity gradient", 35.0),
        ("constant world torque", None),
    )
    times = tuple(Figure(f"forced.{key(name)}.time", cost.format(name), "us", most) for name, most in targets)
    floors = tuple(Figure(f"forced.{key(name)}.floor", floor.format(name), "", 10.0) for name, _ in targets)
    return times + floors


RATIOS: tuple[tuple[str, str, float, float], ...] = (
    ("MuJoCo rk4", "free", 1e-9, 400.0),
    ("MuJoCo rk4", "free", 1e-12, 1500.0),
    ("MuJoCo rk4", "constant world torque", 1e-9, 400.0),
    ("MuJoCo rk4", "constant world torque", 1e-12, 1500.0),
    ("scipy DOP853", "free", 1e-9, 250.0),
    ("scipy DOP853", "free", 1e-12, 400.0),
    ("scipy DOP853", "constant world torque", 1e-9, 250.0),
    ("scipy DOP853", "constant world torque", 1e-12, 400.0),
    ("heyoka Taylor", "free", 1e-12, 1.3),
    ("heyoka Taylor", "constant world torque", 1e-12, 1.3),
    ("heyoka Taylor", "free, 1000 s", 1e-11, 1.3),
    ("heyoka Taylor", "free, 1000 s", 1e-12, 1.3),
)
"""Contender, problem, error, and the minimum speed ratio of bodycheck to it."""


def _against() -> tuple[Figure, ...]:
    return tuple(
        Figure(
            ratio_name(rival, problem, error),
            f"times as fast as {rival}, {problem}, to {error:.0e} rad",
            "x",
            at_least=least,
        )
        for rival, problem, error, least in RATIOS
    )


TREE_RATIOS: tuple[tuple[str, str, float | None], ...] = (
    ("double-pendulum", "MuJoCo rk4", 8.0),
    ("double-pendulum", "DOP853", 3.0),
    ("double-pendulum", "heyoka Taylor", None),
    ("free-chain", "MuJoCo rk4", 5.0),
    ("free-chain", "DOP853", 3.0),
    ("free-chain", "heyoka Taylor", None),
    ("quadruped", "MuJoCo rk4", 2.0),
    ("quadruped", "DOP853", 3.0),
)
"""Built-in tree, contender, and the minimum speed ratio of the series to it, at 1e-9."""


def _trees() -> tuple[Figure, ...]:
    ratios = tuple(
        Figure(
            f"trees.{tree}.{key(rival)}", f"times as fast as {rival}, {tree}, to 1e-9", "x", at_least=least
        )
        for tree, rival, least in TREE_RATIOS
    )
    return *ratios, Figure("trees.truth", "certified truth of the quadruped, 1 s", "s", at_most=0.2)


def _drift() -> tuple[Figure, ...]:
    kept = {
        "energy": "energy, free",
        "momentum": "angular momentum of the world, free",
        "norm": "quaternion's norm, free",
        "top-energy": "energy, heavy top",
        "top-momentum": "angular momentum about the vertical, heavy top",
    }
    sizes = tuple(
        Figure(f"drift.{name}.size", f"relative drift of the {what}, over the steps", "", at_most=2e-14)
        for name, what in kept.items()
    )
    growths = tuple(
        Figure(f"drift.{name}.growth", f"p of that drift's growth as steps^p: {what}", "", at_most=0.5)
        for name, what in kept.items()
    )
    return sizes + growths


def key(words: str) -> str:
    """Return words in the form used in names of figures."""
    return words.replace(",", "").replace(" ", "-")


def ratio_name(contender: str, problem: str, error: float) -> str:
    """Return the name of the figure that states the speed ratio to a contender at an error."""
    return f"against.{key(contender)}.{key(problem)}.{error:.0e}"


FIGURES: tuple[Figure, ...] = (
    Figure("free.time", "free rotation in closed form, each time after set-up", "ns", at_most=250.0),
    Figure("free.set-up.diagonal", "its set-up, principal axes", "us", at_most=50.0),
    Figure("free.set-up.full", "its set-up, full tensor", "us", at_most=50.0),
    *_forced(),
    *_against(),
    *_drift(),
    *_trees(),
    Figure("batch.rk4", "batch of free bodies, RK4, body-steps", "1/s", at_least=3e8),
    Figure("batch.dop853", "batch of free bodies, order 8, body-steps", "1/s", at_least=4e7),
    Figure(
        "truth.time", "certified truth, 10 s, compiled before, the slowest of the forced", "ms", at_most=20.0
    ),
    Figure("truth.bound", "its bound at 10 s, the largest of the forced", "rad", at_most=1e-15),
    Figure("mesh.time", "mass properties of a mesh", "ms", at_most=3.0),
    Figure("mesh.error", "their relative error, at the origin", "", at_most=1e-15),
    Figure("mesh.error-far", "their relative error, 1000 m off the origin", "", at_most=1e-15),
    Figure("mesh.against-trimesh", "times as fast as trimesh", "x", at_least=25.0),
    Figure("start.first", "first bodycheck truth, no kernel compiled yet", "s", at_most=25.0),
    Figure("start.later", "later ones", "s", at_most=2.5),
    Figure("specialised.free", "gain of a kernel without loads, free, over the general one", "x"),
    Figure("specialised.rotation", "gain of a kernel without translation, world torque", "x"),
)
