"""Rows of a recording that are wrong, or late by one row, where the rest of the motion is right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bodycheck.recordings.conversion import RecordedMotion
from bodycheck.recordings.judged_motion import (
    TURNING,
    JudgedMotion,
    Start,
    is_free,
    judged_motion,
    quantities_of,
)
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.problem import Problem

_FAR = 10.0  # times what the file and the truth leave open
_FEWEST_ROWS = 10  # of a file whose first row can be told from its motion
_LEFT = 1e-3  # of the largest error, without the wrong rows, where these alone are wrong
_OFF = 0.1  # of the largest error, above which a row is off
_FEW = 0.01  # of the rows
_ENOUGH = 5  # rows: of fewer, one that is off is no exception
_JUMP = 1e-2  # of what is off: an error that grows up to the last row comes nearer to it


@dataclass(frozen=True, eq=False)
class Exceptions:
    """Few rows that are off, of all that were compared.

    off: their places, in order. largest, rest: the largest error of these and of the others, in rad or rad/s.
    """

    rows: int
    off: tuple[int, ...]
    largest: float
    rest: float


def exceptions_of(motion: JudgedMotion) -> dict[str, Exceptions]:
    """Return, by measure, the few rows that are off in attitude or omega, ten times as far as the others."""
    found = {}
    for name in TURNING:
        if name not in motion.row or motion.is_at_floor(name):
            continue
        errors = motion.case.series[name]
        largest = float(errors.max())
        limit = _OFF * largest
        off = np.flatnonzero(errors > limit)
        rest = float(np.delete(errors, off).max(initial=0.0))
        is_growth = off[-1] == len(errors) - 1 and rest > _JUMP * limit
        if len(errors) >= _ENOUGH and len(off) <= max(1.0, _FEW * len(errors)) and not is_growth:
            found[name] = Exceptions(len(errors), tuple(off.tolist()), largest, rest)
    return found


def is_right_elsewhere(motion: JudgedMotion) -> bool:
    """Whether some rows are wrong, or late, and nothing else: a search for a cause would end at these."""
    if motion.repaired is not None:
        return True
    ordinary = _without_exceptions(motion)
    return ordinary is not motion and _is_repaired(ordinary, motion)


def _without_exceptions(motion: JudgedMotion) -> JudgedMotion:
    """Return a motion with the errors of the rows that are not off, itself if none is off alone."""
    found = exceptions_of(motion)
    rest = {name: motion.row[name] * (of.rest / of.largest) for name, of in found.items()}
    return replace(motion, row=motion.row | rest) if rest else motion


def _is_repaired(later: JudgedMotion, motion: JudgedMotion) -> bool:
    """Whether a motion without what is wrong is the true one, or leaves little of the errors."""
    left, whole = (max(one.row.get(name, 0.0) for name in TURNING) for one in (later, motion))
    return later.is_true or left <= _LEFT * whole


def with_repair(
    path: Path, name: str, recorded: RecordedMotion, problem: Problem, cache: Cache | None, start: Start
) -> JudgedMotion:
    """Measure a recording, also without what many programs log wrongly, if that alone may be wrong.

    Single rows that are off, in the file or without that, are no reason for or against it.
    """
    motion = judged_motion(path, name, recorded, problem, cache, start)
    ordinary = _without_exceptions(motion)
    is_off = any(ordinary.row.get(one, 0.0) > _FAR * motion.floor(one) for one in TURNING)
    if not is_off or len(recorded.arrays["t_s"]) <= _FEWEST_ROWS:
        return motion
    for wrong, repaired in _repairs(recorded, problem.of_body.scene, start):
        later = judged_motion(path, name, repaired, problem, None, start)
        if later.row["outcome"] == "ok" and _is_repaired(_without_exceptions(later), ordinary):
            return replace(motion, repaired=(wrong, later))
    return motion


_OMEGA_LATE, _ATTITUDE_LATE = "Omega is one row behind the attitude", "The attitude is one row behind omega"
_APART = (
    ("omega", 1, _OMEGA_LATE),
    ("attitude", 1, _ATTITUDE_LATE),
    ("omega", -1, _ATTITUDE_LATE),
    ("attitude", -1, _OMEGA_LATE),
)
"""A quantity, the rows by which it is moved, and what is wrong if the motion is the true one then."""


def _repairs(recorded: RecordedMotion, scene: Scene, start: Start) -> Iterator[tuple[str, RecordedMotion]]:
    """Yield what may be wrong with a recording, and the recording without it.

    Many programs log a first row before the first step, without the velocities, or one quantity before a
    step and the other after it.
    """
    from_first, arrays = start == "first-sample", recorded.arrays
    if from_first and is_free(scene) and (rest := recorded.from_second_row()) is not None:
        yield "Only the first row, or the step from it, is wrong. From the second row on", rest
    has_one_omega = ("omega_body_rad_s" in arrays) != ("omega_world_rad_s" in arrays)
    if has_one_omega and "attitude" in quantities_of(arrays) and not recorded.has_derived_omega:
        # of a motion that starts at its first row, the other two differ in the times alone
        for quantity, rows, wrong in _APART[:2] if from_first else _APART:
            yield f"{wrong}. Moved by one row", recorded.moved(quantity, rows)
