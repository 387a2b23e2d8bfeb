"""Rows of a recording that are wrong, or late by one row, where the rest of the motion is right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from bodycheck.examine.diagnosis.recorded import omegas_meant
from bodycheck.recordings.conversion import RecordedMotion
from bodycheck.recordings.judged_motion import (
    QUANTITY_OF,
    TURNING,
    JudgedMotion,
    Repair,
    Start,
    is_free,
    judged_motion,
    quantities_of,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.problem import Problem

_FAR = 10.0  # times what the file and the truth leave open
_FEWEST_ROWS = 10  # of a file whose first row can be told from its motion
_LEFT = 1e-3  # of the largest error, without the wrong rows, where these alone are wrong
_OFF = 0.1  # of the largest error, above which a row is off
_FEW = 0.01  # of the rows
_ENOUGH = 5  # rows: of fewer, one that is off is no exception
_UNSTABLE = 1.0  # rad, or relative: a motion without measures is at least as far off
_JUMP = 1e-2  # of what is off: an error that grows up to the last row comes nearer to it


@dataclass(frozen=True, eq=False)
class Exceptions:
    """Few rows that are off, of all that were compared.

    off: their places, in order. largest, rest: the largest error of these and of the others, in SI units;
    largest is the distance from the rows beside it where they stand out of noise. noise: its standard
    deviation. left: what the others leave of the largest error.
    """

    rows: int
    off: tuple[int, ...]
    largest: float
    rest: float
    left: float
    noise: float = 0.0


def exceptions_of(motion: JudgedMotion) -> dict[str, Exceptions]:
    """Return, by measure, the few rows that are off, and the errors of the others.

    They are ten times as far off as the others, or stand out of noise, or of errors that change slowly.
    """
    turning = (name for name in TURNING if name in motion.row and not motion.is_at_floor(name))
    found = {name: _exceptions(motion, name) for name in (*turning, *motion.path_errors)}
    return {name: one for name, one in found.items() if one is not None}


def _exceptions(motion: JudgedMotion, measure: str) -> Exceptions | None:
    sizes = errors = motion.case.series[measure]
    if len(errors) < _ENOUGH:
        return None
    deviation = 0.0
    off, noise = _far_off(errors), motion.noise.get(QUANTITY_OF[measure])
    if not off and noise is not None and noise.off:
        off, sizes, deviation = noise.off, noise.apart, noise.deviation
    if not (off := off or _standing_out(errors)):
        return None
    rest = float(np.delete(errors, off).max(initial=0.0))
    return Exceptions(
        len(errors), off, float(sizes[[*off]].max()), rest, rest / float(errors.max()), deviation
    )


def _far_off(errors: Array) -> tuple[int, ...]:
    """Return the few rows that are ten times as far off as the others; the largest hides no smaller one."""
    off: tuple[int, ...] = ()
    while True:
        limit = _OFF * np.delete(errors, [*off]).max(initial=0.0)
        farther = np.flatnonzero(errors > limit)
        is_growth = (
            farther[-1] == len(errors) - 1 and np.delete(errors, farther).max(initial=0.0) > _JUMP * limit
        )
        if len(farther) == len(off) or len(farther) > max(1.0, _FEW * len(errors)) or is_growth:
            return off
        off = tuple(farther.tolist())


def _standing_out(errors: Array) -> tuple[int, ...]:
    """Return the few rows whose error differs from those beside it by ten times any other change of a row."""
    beside = np.stack([errors[:-2], errors[1:-1], errors[2:]])
    apart = np.abs(errors[1:-1] - np.median(beside, axis=0))
    off = 1 + np.flatnonzero(apart > _OFF * apart.max())
    if not 0 < len(off) <= max(1.0, _FEW * len(errors)):  # none where errors grow throughout
        return ()
    changes = np.delete(np.abs(np.diff(errors)), [*(off - 1), *off])
    is_alone = _OFF * apart[off - 1].min() > changes.max(initial=0.0)
    return tuple(off.tolist()) if is_alone else ()


def is_right_elsewhere(motion: JudgedMotion) -> bool:
    """Whether some rows are wrong, or late, and nothing else: a search for a cause would end at these."""
    if motion.repaired is not None:
        return True
    ordinary = without_exceptions(motion)
    return ordinary is not motion and _is_repaired(ordinary, motion)


def without_exceptions(motion: JudgedMotion) -> JudgedMotion:
    """Return a motion with the errors of the rows that are not off, itself if none is off alone."""
    found = exceptions_of(motion)
    rest = {name: motion.row[name] * of.left for name, of in found.items()}
    return replace(motion, row=motion.row | rest) if rest else motion


def _is_repaired(later: JudgedMotion, motion: JudgedMotion, left: float = _LEFT) -> bool:
    """Whether a motion without what is wrong is the true one, or leaves little of the errors."""
    return _is_right(later, motion) or _largest(later) <= left * _largest(motion)


def _is_right(later: JudgedMotion, motion: JudgedMotion) -> bool:
    """Whether a motion without what is wrong is the true one; of an unstable one, to the noise of rows."""
    is_noise = all(later.is_noise(one) for one in TURNING if one in later.row)
    return later.is_true or (is_noise and not motion.case.ok)


def _with_omega_meant(
    path: Path,
    name: str,
    recorded: RecordedMotion,
    problem: Problem,
    cache: Cache | None,
    motion: JudgedMotion,
) -> JudgedMotion | None:
    """Measure a recording from the omega that was meant, if its attitude is then the true one, or nearly."""
    trajectory = motion.case.trajectory
    if trajectory is None or not motion.known >= {"attitude", "omega"} or recorded.without_omega:
        return None
    judged = partial(judged_motion, path, name, problem=problem, cache=cache, start="first-sample")
    for _, meant in omegas_meant(trajectory):
        right = judged(recorded.with_omega_of(meant))
        if right.case.ok and (
            right.is_true_by(ORIENTATION)
            or right.is_noise(ORIENTATION)
            or right.row[ORIENTATION] <= _LEFT * motion.row.get(ORIENTATION, _UNSTABLE)
        ):
            as_read, of_attitude = judged(recorded, meant=meant), right.floors[ORIENTATION]
            floors = {**as_read.floors, ORIENTATION: of_attitude}
            return replace(as_read, floors=floors, noise=right.noise, is_omega_misread=True)
    return None


def _largest(motion: JudgedMotion) -> float:
    if not motion.case.ok:
        return _UNSTABLE
    return float(max(motion.row.get(name, 0.0) for name in TURNING))


def with_repair(
    path: Path, name: str, recorded: RecordedMotion, problem: Problem, cache: Cache | None, start: Start
) -> JudgedMotion:
    """Measure a recording, also without what many programs log wrongly, if that alone may be wrong.

    Where a misread omega is all that is wrong, the truth starts at the omega that was meant. Single rows that
    are off, in the file or without that, are no reason for or against it. Where more is wrong than these,
    also measure the longest part without them.
    """
    motion = judged_motion(path, name, recorded, problem, cache, start)
    ordinary = without_exceptions(motion)
    is_off = any(ordinary.row.get(one, 0.0) > _FAR * motion.floor(one) for one in TURNING)
    if (motion.case.ok and not is_off) or len(recorded.arrays["t_s"]) <= _FEWEST_ROWS:
        return motion
    repair = _best_repair(path, name, recorded, problem, start, ordinary)
    if repair is not None:
        return replace(motion, repaired=repair)
    if start == "first-sample" and (right := _with_omega_meant(path, name, recorded, problem, cache, motion)):
        return right
    if ordinary is motion or is_right_elsewhere(motion):
        return motion
    return replace(motion, part=_part(path, name, recorded, problem, motion))


def _best_repair(
    path: Path, name: str, recorded: RecordedMotion, problem: Problem, start: Start, motion: JudgedMotion
) -> Repair | None:
    """Return the repair that leaves least of the errors of a motion, None if much is left."""
    found: list[tuple[float, Repair, JudgedMotion]] = []
    for wrong, first_rows, repaired in _repairs(recorded, start):
        later = judged_motion(path, name, repaired, problem, None, start)
        if later.row["outcome"] == "ok":
            rest = without_exceptions(later)
            left = 0.0 if _is_right(rest, motion) else _largest(rest)
            found.append((left, Repair(wrong, first_rows, later), rest))
    if not found:
        return None
    _, repair, rest = min(found, key=lambda one: one[0])
    # at the time of the second row, loads may differ from those at the start
    is_later = repair.first_rows == _SECOND_ROW and not is_free(problem.of_body.scene)
    return repair if _is_repaired(rest, motion, _LEFT**2 if is_later else _LEFT) else None


def _part(
    path: Path, name: str, recorded: RecordedMotion, problem: Problem, motion: JudgedMotion
) -> JudgedMotion | None:
    """Measure the longest part between rows that are off; None if it is too short."""
    off = sorted({row for found in exceptions_of(motion).values() for row in found.off})
    parts = [*pairwise([-1, *off, len(recorded.arrays["t_s"])])]
    if not is_free(problem.of_body.scene):  # the loads of a later time may differ
        parts = parts[:1]
    before, end = max(parts, key=lambda ends: ends[1] - ends[0])
    if end - before <= _FEWEST_ROWS or (rows := recorded.rows(before + 1, end)) is None:
        return None
    part = judged_motion(path, name, rows, problem, None, motion.start if before < 0 else "first-sample")
    return part if part.case.ok else None


_OMEGA_LATE, _ATTITUDE_LATE = "Omega is one row behind the attitude", "The attitude is one row behind omega"
_APART = (
    ("omega", 1, _OMEGA_LATE),
    ("attitude", 1, _ATTITUDE_LATE),
    ("omega", -1, _ATTITUDE_LATE),
    ("attitude", -1, _OMEGA_LATE),
)
"""A quantity, the rows by which it is moved, and what is wrong if the motion is the true one then."""

_SECOND_ROW = dict.fromkeys(TURNING, 1)


def _repairs(recorded: RecordedMotion, start: Start) -> Iterator[tuple[str, dict[str, int], RecordedMotion]]:
    """Yield what may be wrong with a recording, where its measures then begin, and the recording without it.

    Many programs log a first row before the first step, without the velocities, or one quantity before a
    step and the other after it.
    """
    from_first, arrays = start == "first-sample", recorded.arrays
    if from_first and (rest := recorded.rows(1, len(arrays["t_s"]))) is not None:
        yield "Only the first row, or the step from it, is wrong. From the second row on", _SECOND_ROW, rest
    has_one_omega = ("omega_body_rad_s" in arrays) != ("omega_world_rad_s" in arrays)
    if has_one_omega and "attitude" in quantities_of(arrays) and not recorded.without_omega:
        # of a motion that starts at its first row, the other two differ in the times alone
        for quantity, rows, wrong in _APART[:2] if from_first else _APART:
            of_omega = int((quantity == "omega") == (rows > 0))
            first_rows = dict(zip(TURNING, (1 - of_omega, of_omega), strict=True))
            yield f"{wrong}. Moved by one row", first_rows, recorded.moved(quantity, rows)
