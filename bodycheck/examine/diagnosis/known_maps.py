"""The maps of the library, as fingerprints know them, on the transitions of a trajectory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import LIBRARY, Base, States
from bodycheck.examine.diagnosis.transitions import Transitions
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps import EXACT
from bodycheck.reports.run_files.method_words import map_in_words

_SCREENED, _DECIDED = 6, 2000  # transitions: of a longer log these are as many as tell maps apart
_NEAR = 1.4  # multiples of the limit, within which a map is whitened by its own derivatives
_NEAR_BY_LOADS = 100.0  # multiples of the nearest map, within which other treatments of loads are tried
_SAME_NORM = 3.0  # multiples of the resolution
_ROUND_OFF = 1e-14
FARTHER = 10.0
"""Times as far from the exact motion as the representatives of its order: no map is farther."""

HELD_ALIKE = 0.1
"""Share of the effect of holding loads, by which it differs between maps of one order, besides `FARTHER`."""

REPRESENTATIVES = {
    1: (
        "M1, pose from the old omega, omega in world axes, additive matrix",
        "M3, pose from the old omega, omega in world axes",
        "backward Euler, additive quaternion",
        "backward Euler, omega in world axes, additive quaternion",
        "backward Euler, angular momentum in world axes, additive quaternion",
    ),
    2: (
        "SPIRAL",
        "Heun 2, angular momentum in world axes, additive matrix projected",
        "Buss 2000, order 2 augmented",
        "Heun 2 on the rotation group, stages averaged, omega in world axes",
        "Gauss 2, omega in world axes, additive quaternion",
    ),
    3: (
        "Buss 2000, order 3",
        "RK3 (Ralston), omega in world axes, additive matrix projected",
        "CG3, omega in world axes",
    ),
    4: (
        "Buss 2000, order 4",
        "RK4 (3/8 rule), omega in world axes, additive matrix",
        "RK4 (3/8 rule) Munthe-Kaas, two commutators, omega in world axes",
    ),
    5: (
        "splitting6",
        "RK5 (Nystrom), omega in world axes, additive matrix projected",
        "RK5 (Fehlberg), angular momentum in world axes, additive matrix",
    ),
}
"""Order of maps, 5 for all higher ones -> those that depart farthest from the exact motion."""


def maps_of(transitions: Transitions) -> list[Base]:
    """Return every map of the library that could have made a trajectory, in the order of the library.

    transitions: all of them, of which those of a long log are tried in a subset. A map that evaluates loads
    more than once is also tried with loads that are held over the step.
    """
    every = replace(transitions, from_rows=True)
    few = every.alone().subset(_SCREENED)
    reach = _Reach(few)
    held_maps = {base.name: [one for one in _held(base) if few.scene.loads and one in reach]
                 for base in LIBRARY.values()}  # fmt: skip
    plain = _with_costs(few, [one for one in LIBRARY.values() if held_maps[one.name] or one in reach])
    near = _NEAR_BY_LOADS * min((cost for _, cost, _ in plain), default=0.0)
    possible = []
    for base, cost, state in plain:
        held = _with_costs(few, held_maps[base.name]) if cost <= near else []
        for one, off, after in [(base, cost, state), *held]:
            if off <= few.limit and _has_norm(few, one, after):
                possible.append(one)
    many = every if every.whitening is not None else every.subset(_DECIDED)
    found = _fitting(many, possible)
    is_whole = many is every or bool(_fitting(every, found[:1]))  # one wrong row may not be among the many
    return found if is_whole else _fitting(every, found)


@dataclass(frozen=True, eq=False)
class _Reach:
    """The maps that can have made transitions: those no farther than `FARTHER` allows.

    Any map, where the matrices of a recording have lost their orthogonality: a map that multiplies by them
    is then as far from the exact motion as they are from rotations, however small its step.
    """

    transitions: Transitions

    def __contains__(self, base: Base) -> bool:
        if self._has_stretched:
            return True
        distance, limit = self._distances[min(base.order, max(REPRESENTATIVES)), base.in_body_axes]
        return distance <= limit

    @cached_property
    def _has_stretched(self) -> bool:
        path = self.transitions.trajectory
        if path.rotation is None or "attitude" not in self.transitions.known:
            return False
        return bool(np.max(np.abs(_gram(path.rotation) - np.eye(3))) > _allowed_norm(self.transitions))

    @cached_property
    def _distances(self) -> dict[tuple[int, bool | None], tuple[float, float]]:
        """Order, axes in which loads are held -> the distance from these maps, and the largest allowed one.

        In root mean square. Plain maps are around the exact motion; those with held loads around one of them.
        """
        some = self.transitions
        found: dict[tuple[int, bool | None], tuple[float, float]] = {}
        exact = self._differences([Base(EXACT.name, "", one=EXACT)])
        for order, names in REPRESENTATIVES.items():
            maps = [LIBRARY[name] for name in names]
            departures = self._differences(maps) - exact
            allowed = some.limit + FARTHER * max(map(some.cost_of, departures))
            found[order, None] = some.cost_of(exact), allowed
            for held in next(filter(None, ([*_held(one)] for one in maps))):
                gap = self._differences([held])
                also = HELD_ALIKE * some.cost_of(gap - exact)
                found[order, held.in_body_axes] = some.cost_of(gap), allowed + also
        return found

    def _differences(self, maps: Sequence[Base]) -> Array:
        some = self.transitions
        return some.weighted(some.gaps_after(some.after(maps)))


def _held(base: Base) -> Iterator[Base]:
    """Yield the map with its loads held over the step, in world and in body axes."""
    if base.one is not None and base.one.stages:
        for in_body_axes, axes in ((False, "world"), (True, "body")):
            name = f"{base.name}, loads held in {axes} axes"
            yield replace(
                base,
                name=name,
                text=f"{map_in_words(name)}, {base.one.description}",
                in_body_axes=in_body_axes,
            )


def _with_costs(transitions: Transitions, maps: Sequence[Base]) -> list[tuple[Base, float, States]]:
    """Return each map with the root mean square of its differences, and its states after the transitions."""
    if not maps:
        return []
    after = transitions.after(maps)
    costs = map(transitions.cost_of, transitions.weighted(transitions.gaps_after(after)))
    return list(zip(maps, costs, after, strict=True))


def _fitting(transitions: Transitions, maps: Sequence[Base]) -> list[Base]:
    """Return the maps that could have made the transitions."""
    costs = _with_costs(transitions, maps)
    return [one for one, cost, _ in costs if _settled(transitions, one, cost) <= transitions.limit]


def _settled(transitions: Transitions, base: Base, cost: float) -> float:
    """Return the cost of a map, whitened by its own derivatives where these could decide about it."""
    if transitions.whitening is None or not 1.0 / _NEAR < cost / transitions.limit <= _NEAR:
        return cost
    return _with_costs(transitions.whitened_by(base), [base])[0][1]


def _has_norm(transitions: Transitions, base: Base, after: States) -> bool:
    """Whether the norms of quaternions, or the matrices, are those that a map makes."""
    path, rows = transitions.trajectory, transitions.indices
    if "attitude" not in transitions.known:
        return True
    allowed = _allowed_norm(transitions)
    if path.quaternion is not None:
        start, recorded = (np.linalg.norm(path.quaternion[at], axis=-1) for at in (rows, rows + 1))
        made = np.linalg.norm(after.q[:, 0], axis=0)
        if base.one is not None and base.one.attitude == "quaternion":
            made = made * start  # linear in the quaternion, of which the direction alone is advanced
        gap: Array = np.abs(made - recorded)
    else:
        assert path.rotation is not None
        recorded = path.rotation[rows + 1]
        made = np.eye(3) if after.held is None else np.moveaxis(after.held[:, :, 0], -1, 0)
        gap = np.abs(_gram(made) - _gram(recorded))
    return bool(np.max(gap) <= allowed)


def _allowed_norm(transitions: Transitions) -> float:
    """Return how far norms may be off one another that are equal but for digits and round-off."""
    return _SAME_NORM * transitions.resolution.attitude + _ROUND_OFF * transitions.grid.stride


def _gram(matrix: Array) -> Array:
    """M^T M (..., 3, 3)."""
    return np.swapaxes(matrix, -1, -2) @ matrix
