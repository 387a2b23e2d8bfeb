"""The contract between a solver and the benchmark that tunes and times it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from benchmarks.problems import End, Problem

Knob: TypeAlias = Literal["steps", "tolerance", "none"]


class Task(Protocol):
    """What can be timed again and again."""

    def reset(self) -> None:
        """Go back to the start. Not timed."""

    def run(self) -> None:
        """Go from the start to the end. This is what is timed."""


class Solver(Task, Protocol):
    """One problem, at one setting, made ready."""

    def end(self) -> End:
        """Return where the last run came to."""


@dataclass(frozen=True)
class Contender:
    """A solver and the one knob by which it is tuned.

    settings: of the knob, the cheapest first. prepare: builds and compiles what a problem at a setting
    needs; timed apart from the running.
    """

    name: str
    version: str
    knob: Knob
    settings: tuple[float, ...]
    prepare: Callable[[Problem, float], Solver]


_FINENESS = 8  # settings to an octave of steps, or to a decade of tolerance


def step_counts(fewest: int, most: int) -> tuple[float, ...]:
    """round(fewest 2^(k/8)), up to the most: nine per cent apart."""
    last = math.floor(_FINENESS * math.log2(most / fewest))
    return tuple(sorted({float(round(fewest * 2.0 ** (k / _FINENESS))) for k in range(last + 1)}))


def tolerances(loosest: float, tightest: float) -> tuple[float, ...]:
    """Loosest 10^(-k/8), down to the tightest."""
    last = math.floor(_FINENESS * math.log10(loosest / tightest) + 1e-9)
    return tuple(loosest * 10.0 ** (-k / _FINENESS) for k in range(last + 1))
