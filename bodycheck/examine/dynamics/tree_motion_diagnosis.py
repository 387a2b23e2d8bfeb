"""Name what explains the motion of a tree: its map, or a map with a fault of the catalogue.

From the engine's own state at one sample, a map with a fault makes the steps to the next; the parameters are
those that leave least of the differences. All faults are fitted at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bodycheck.adapters.contract import Precision
from bodycheck.adapters.stable_step import kinetic_limit
from bodycheck.examine.diagnosis.diagnosis import ALL, Diagnosis, FittedFault, FittedParameter
from bodycheck.examine.diagnosis.faults.fault import number_text
from bodycheck.examine.dynamics.faults import TREE_FAULTS
from bodycheck.examine.dynamics.faults.tree_fault import TreeFault
from bodycheck.examine.dynamics.tree_case import TreeCase, TreeState
from bodycheck.examine.dynamics.tree_flow import TreeFlow, TreeHypothesis
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS
from bodycheck.reference_impl.pivot import kinetic_energies
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.reports.measurement.scales import Scales
from bodycheck.reports.measurement.tree_map_made import MADE, state_differences
from bodycheck.reports.run_files.method_words import map_in_words

_MAX_STRIDE = 400
_TRANSITIONS, _STEPS = 6, 200  # at most, of all transitions together, but at least two transitions
_ROWS = 4000  # of one call
_ITERATIONS, _SOON, _SHORTER = 12, 3, 5
_CHANGE = 1e-6
_LEADERS = 12
_EXPLAINED, _NEARLY = 0.02, 0.5
"""Of the differences, at most, that a fault leaves: one that explains the motion, and one that is near."""
_TIE, _ROUND_OFF = 3.0, 1e-12
_ACCURATE = "RK4"  # the map that stands for the exact motion
_SPECIAL = 1e-3
_FAR = 1e3  # a difference beyond which a hypothesis has diverged
_SAMPLED, _ULPS = 3, 30.0
"""Trees whose numbers are off by an ulp, and how many ulps a motion may be off."""
_NEARLY_MADE: dict[Precision, float] = {"float64": 1e-6, "float32": 1e-3, "mixed": 1e-3}


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A fault of some bodies with its parameters, and what it leaves: residual (m,)."""

    fault: TreeFault
    bodies: tuple[int, ...]
    base: str
    values: Array
    residual: Array
    slopes: Array | None = None
    is_settled: bool = False

    @property
    def cost(self) -> float:
        """The root mean square of what is left."""
        return float(np.sqrt(np.mean(self.residual**2)))


@dataclass(frozen=True, eq=False)
class _Transitions:
    """Intervals between samples: their starts and ends, each of so many steps, and where loads switch."""

    scene: TreeScene
    begin_s: Array
    switches: NDArray[np.bool_]
    starts: tuple[Array, Array]
    ends: tuple[Array, Array]
    dt_s: float
    stride: int
    scales: Scales

    @classmethod
    def of(cls, scene: TreeScene, motion: Trajectory, scales: Scales, dt_s: float) -> _Transitions | None:
        """Return the first interval, those that begin where a load switches, and others between; or None.

        All end before the motion breaks down: what an engine does then, such as setting to 0 what is not
        finite, is no step of a map.
        """
        if motion.q is None or motion.u is None:
            return None
        with np.errstate(over="ignore", invalid="ignore"):
            energies = kinetic_energies(scene, motion)[0]
        broken = np.flatnonzero(~(energies <= kinetic_limit(np.array(scales.energy_scale_j))))
        stride, last = steps_per_sample(scene.sample_interval_s, dt_s), len(motion.t_s) - 1
        last = min([last, *(broken[:1] - 1).tolist()])
        if last < 1 or stride > _MAX_STRIDE:
            return None
        switched = [int(t / scene.sample_interval_s + 1e-9) for t in scene.switches_before(scene.duration_s)]
        number = max(2, min(_TRANSITIONS, _STEPS // stride))
        even = np.linspace(0, last - 1, min(number, last)).astype(int).tolist()
        chosen = np.array(sorted({0, *[k for k in switched if k < last], *even}))
        starts, ends = ((motion.q[at], motion.u[at]) for at in (chosen, chosen + 1))
        return cls(scene, motion.t_s[chosen], np.isin(chosen, switched), starts, ends, dt_s, stride, scales)

    @property
    def few(self) -> _Transitions:
        """The first interval, the last, and the first of those that begin where a load switches."""
        inside = np.flatnonzero(self.switches[1:-1]) + 1
        at = sorted({0, len(self.begin_s) - 1, *inside[:1].tolist()})
        starts, ends = ((q[at], u[at]) for q, u in (self.starts, self.ends))
        return replace(self, begin_s=self.begin_s[at], switches=self.switches[at], starts=starts, ends=ends)

    def residuals(self, models: Sequence[TreeHypothesis], base: str) -> Array:
        """Return what the steps of models leave of the ends (models, m)."""
        number = len(self.begin_s)
        found = []
        at_once = max(1, _ROWS // number)
        for first in range(0, len(models), at_once):
            some = models[first : first + at_once]
            rows = [model for model in some for _ in range(number)]
            q, u = (np.tile(part, (len(some), 1)) for part in self.starts)
            flow = TreeFlow(rows, base, np.tile(self.begin_s, len(some)), self.dt_s)
            with np.errstate(all="ignore"):
                made = flow.advance(q, u, self.stride)
                q, u = (np.tile(part, (len(some), 1)) for part in self.ends)
                parts = state_differences(self.scene, (q, u), made, self.scales)
                left = np.hstack([part for part, _ in parts])
            left = np.clip(np.nan_to_num(left, nan=_FAR), -_FAR, _FAR)
            found.append(left.reshape(len(some), -1))
        return np.concatenate(found)


def diagnosed_tree(
    scene: TreeScene,
    motion: Trajectory,
    scales: Scales,
    dt_s: float | None,
    *,
    order: int | None = None,
    precision: Precision = "float64",
) -> Diagnosis | None:
    """Return what explains the motion of a tree; None where it cannot be examined.

    Not examined are methods without steps, motions with more than 400 steps between two samples, those that
    break down within the first, and those of engines that store poses only.
    """
    seen = None if dt_s is None else _Transitions.of(scene, motion, scales, dt_s)
    if seen is None:
        return None
    left = {name: seen.residuals([TreeHypothesis(scene)], name)[0] for name in TREE_MAPS}
    largest = {name: float(np.max(np.abs(values))) for name, values in left.items()}
    nearest = min(largest, key=lambda name: largest[name])
    if largest[nearest] <= _NEARLY_MADE[precision]:  # else a map is not made, whatever the round-off
        made = max(MADE[precision], _round_off(seen, nearest, precision))
        if largest[nearest] <= made:
            return _healthy(nearest, largest, order, made)
    able = [name for name, one in TREE_MAPS.items() if order is None or (one.order > 1) == (order > 1)]
    able.sort(key=lambda name: largest[name])
    screened = sorted(_fitted(seen.few, able[0], _candidates(scene)), key=lambda fit: fit.cost)
    leaders = [(fit.fault, fit.bodies, fit.values) for fit in screened[:_LEADERS]]
    fits: list[_Fitted] = []
    for name in able:
        if fits and fits[0].cost <= _ROUND_OFF:
            break
        fits = sorted([*fits, *_fitted(seen, name, leaders)], key=lambda fit: fit.cost)
    return _conclusion(scene, fits, left, able[0], precision)


def _round_off(seen: _Transitions, base: str, precision: Precision) -> float:
    """Return how far round-off may move a motion: by masses and moments that are off by some ulps."""
    ulp = float(np.finfo(np.float32 if precision != "float64" else np.float64).eps)
    rng, scene = np.random.default_rng(1), seen.scene
    models = [TreeHypothesis(scene)]
    for _ in range(_SAMPLED):
        off = 1.0 + ulp * rng.choice([-1.0, 1.0], (len(scene.bodies), 2))
        parts = zip(scene.bodies, off, strict=True)
        bodies = (replace(body, mass=a * body.mass, inertia=b * body.inertia) for body, (a, b) in parts)
        models.append(TreeHypothesis(replace(scene, bodies=tuple(bodies))))
    exact, *others = seen.residuals(models, base)
    return _ULPS * max(float(np.max(np.abs(other - exact))) for other in others)


def _healthy(base: str, largest: dict[str, float], order: int | None, limit: float) -> Diagnosis:
    made = [name for name, size in largest.items() if size <= limit]
    right = [name for name in made if order is None or TREE_MAPS[name].order >= order]
    base = right[0] if right else base
    return Diagnosis(
        "healthy" if right else "lower-order",
        base,
        _words(base),
        before=largest[base],
        after=largest[base],
        round_off=limit,
        equal_maps=tuple(name for name in made if name != base),
        order=order,
    )


def _words(base: str) -> str:
    return f"{map_in_words(base)} of trees, {TREE_MAPS[base].description}"


def _candidates(scene: TreeScene) -> Iterator[tuple[TreeFault, tuple[int, ...], Array]]:
    """Yield each fault of motions, its bodies (none, each alone, all), and where a fit starts."""
    case = TreeCase("", (TreeState(scene, scene.q0, scene.u0),))
    for fault in TREE_FAULTS:
        if fault.moves is None or not fault.applies(case):
            continue
        able = () if fault.bodies is None else tuple(fault.bodies(scene))
        if fault.bodies is not None and not able:
            continue
        scopes = [able, *(((body,) for body in able) if len(able) > 1 else ())]
        for bodies in scopes:
            yield fault, bodies, np.array(fault.start)


def _planted(
    scene: TreeScene, fault: TreeFault, bodies: tuple[int, ...], values: Array
) -> TreeHypothesis | None:
    """Return the model with a fault; None if no tree has such parameters."""
    model = TreeHypothesis(scene)
    assert fault.moves is not None
    try:
        fault.moves(model, bodies, values)
    except ValueError:
        return None
    return model


def _fitted(
    seen: _Transitions, base: str, candidates: Iterable[tuple[TreeFault, tuple[int, ...], Array]]
) -> list[_Fitted]:
    """Return the candidates with the parameters that leave least, by Gauss-Newton steps of all at once."""
    scene = seen.scene

    def left_by(some: Sequence[tuple[TreeFault, tuple[int, ...], Array]]) -> list[Array | None]:
        models = [_planted(scene, *one) for one in some]
        possible = [model for model in models if model is not None]
        rows = iter(seen.residuals(possible, base) if possible else ())
        return [None if model is None else next(rows) for model in models]

    some = list(candidates)
    fits = [
        _Fitted(*one[:2], base, one[2], left, is_settled=not len(one[2]))
        for one, left in zip(some, left_by(some), strict=True)
        if left is not None
    ]
    first = seen.residuals([TreeHypothesis(scene)], base)[0]
    healthy = float(np.sqrt(np.mean(first**2)))
    for iteration in range(_ITERATIONS):
        if iteration == _SOON:
            fits = [fit for fit in fits if fit.is_settled or fit.cost < 0.7 * healthy]
        active = [k for k, fit in enumerate(fits) if not fit.is_settled]
        if not active:
            break
        nudged = [
            (fits[k].fault, fits[k].bodies, fits[k].values + _CHANGE * unit)
            for k in active
            for unit in np.eye(len(fits[k].values))
        ]
        changes = iter(left_by(nudged))
        steps: dict[int, Array] = {}
        for k in active:
            columns = [next(changes) for _ in fits[k].values]
            known = [one for one in columns if one is not None]
            if len(known) < len(columns):
                fits[k] = replace(fits[k], is_settled=True)
                continue
            slopes = np.column_stack([(one - fits[k].residual) / _CHANGE for one in known])
            fits[k] = replace(fits[k], slopes=slopes)
            steps[k] = np.asarray(np.linalg.lstsq(slopes, -fits[k].residual, rcond=1e-8)[0], np.float64)
        for _ in range(_SHORTER):
            tried = {k: _within(fits[k].fault, fits[k].values + step) for k, step in steps.items()}
            after = left_by([(fits[k].fault, fits[k].bodies, values) for k, values in tried.items()])
            for (k, values), residual in zip(tried.items(), after, strict=True):
                moved = None if residual is None else replace(fits[k], values=values, residual=residual)
                if moved is not None and moved.cost < fits[k].cost:
                    settled = moved.cost > 0.99 * fits[k].cost or moved.cost < 1e-15
                    fits[k] = replace(moved, is_settled=settled)
                    del steps[k]
            steps = {k: 0.25 * step for k, step in steps.items()}
        for k in steps:
            fits[k] = replace(fits[k], is_settled=True)
    return fits


def _within(fault: TreeFault, values: Array) -> Array:
    low, high = np.array([(one.low, one.high) for one in fault.parameters]).T
    return np.asarray(np.clip(values, low, high))


def _conclusion(
    scene: TreeScene, fits: Sequence[_Fitted], left: dict[str, Array], base: str, precision: Precision
) -> Diagnosis:
    before = float(np.sqrt(np.mean(left[fits[0].base if fits else base] ** 2)))
    if not fits or fits[0].cost > _NEARLY * before:
        return Diagnosis("unexplained", base, _words(base), before=before, after=before)
    tied = max(_TIE * fits[0].cost, _ROUND_OFF, 0.01 * MADE[precision])
    best = sorted((fit for fit in fits if fit.cost <= tied), key=lambda fit: _rank(scene, fit))
    named = [_described(scene, fit) for fit in best]
    after, made = best[0].cost, best[0].base
    share = 1.0 - after / before
    # another map of the order may leave as much as this one does of an accurate one
    error_of_maps = float(np.sqrt(np.mean((left[made] - left[_ACCURATE]) ** 2)))
    is_left = share <= ALL and after > max(MADE[precision], error_of_maps)
    verdict = "nearest" if is_left else "explained"
    found = Diagnosis(verdict, made, _words(made), before=before, after=after, share=share)
    if after > _EXPLAINED * before:
        return replace(found, verdict="unexplained", nearly=(named[0],))
    others = dict.fromkeys(one.sentence for one in named[1:] if one.sentence != named[0].sentence)
    return replace(
        found,
        faults=(named[0],),
        alike=tuple(others),
        alike_names=tuple(dict.fromkeys((one.name,) for one in named[1:] if one.name != named[0].name)),
    )


def _rank(scene: TreeScene, fit: _Fitted) -> tuple[int, int, bool]:
    """Return what comes first of faults that explain a motion equally well: few open parameters."""
    is_open = not _special(scene, fit)
    return len(fit.values) * is_open, TREE_FAULTS.index(fit.fault), len(fit.bodies) > 1


def _special(scene: TreeScene, fit: _Fitted) -> str:
    """Return the sentence of particular values of the parameters, or that of a fault without any."""
    if not len(fit.values):
        return fit.fault.sentence
    case = TreeCase("", (TreeState(scene, scene.q0, scene.u0),))
    for text, known in fit.fault.special(case, fit.bodies[0] if fit.bodies else 0).items():
        if np.allclose(fit.values, known, rtol=_SPECIAL, atol=_SPECIAL):
            return text
    return ""


def _described(scene: TreeScene, fit: _Fitted) -> FittedFault:
    names = [scene.bodies[body].name for body in fit.bodies]
    at = names[0] if len(names) == 1 else "every body"
    text = (_special(scene, fit) or fit.fault.sentence).format(*map(number_text, fit.values), at=at)
    spread = np.zeros(len(fit.values))
    if fit.slopes is not None and len(fit.values):
        spread = 2.0 * fit.cost * np.sqrt(np.diag(np.linalg.pinv(fit.slopes.T @ fit.slopes)))
    parameters = zip(fit.fault.parameters, fit.values, spread, strict=True)
    return FittedFault(
        fit.fault.name,
        "tree",
        text,
        tuple(
            FittedParameter(one.name, one.unit, float(value), float(value - error), float(value + error))
            for one, value, error in parameters
        ),
        "",
    )
