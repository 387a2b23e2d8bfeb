"""Name the fault that explains a wrong motion, or report that none does."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, islice, product

import numpy as np

from bodycheck._util.formatting import names, number
from bodycheck.examine.diagnosis.candidate_maps import BASES, COMMON, EXACT, LIBRARY, Base
from bodycheck.examine.diagnosis.engine_model import Grid
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.fault import Fault, FaultContext
from bodycheck.examine.diagnosis.fit import Fit, Start, fitted, planted
from bodycheck.examine.diagnosis.known_maps import maps_of
from bodycheck.examine.diagnosis.quantity_resolution import NOT_RECORDED, Resolution
from bodycheck.examine.diagnosis.start import StartDifference
from bodycheck.examine.diagnosis.transitions import Transitions
from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS
from bodycheck.reference_impl.scene import GravityGradient, Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.reports.measurement.scales import Scales
from bodycheck.reports.run_files.method_words import map_in_words

ALL_QUANTITIES = frozenset({"position", "velocity", "attitude", "omega"})

_FIRST_LOOK, _SCREENED, _FITTED = 6, 20, 120  # transitions: to choose a map, to screen faults, for the result
_SCREENED_OF_LOG, _FITTED_OF_LOG = 60, 1000  # where the whole log counts; interpolated between them
_FIRST_SWEEPS, _LEADERS = 3, 3  # of all faults; of them, those that are fitted to the end
_SAME_LEADERS = 16  # faults that are tried with further maps of the same order
_EXPLAINED = 0.95  # share of the differences: less is no explanation
_EXPLAINED_TO_NOISE = 0.8  # the same, of faults that leave nothing but noise, whose size is an estimate
_FITTED_PART = 0.6  # of a trajectory, to which faults are fitted that the rest then tests
_EXPLAINED_ELSEWHERE, _NEARLY = 0.9, 0.5  # share of the differences in the rest: of a diagnosis, of a hint
_TIE = 3.0  # a rival is as good if its cost is at most so many times that of the best
_SAME_EFFECT = 0.02  # relative difference of what two faults leave, below which one stands for both
_PARAMETER_COST = 0.1  # decades of the cost that a further parameter must gain
_BETTER = 10.0  # a pair must reduce the cost of a single that explains the motion by this factor
_PAIRED = 8
_NEIGHBOURS = 8  # maps of the library that are tried with a fault
_FORMULATIONS, _NEARLY_ALL = 5, 0.1  # of a tableau, that are tried where a slip leaves so little
_NO_NEARER = 0.99  # of what the faults of a map leave, which no other map is then expected to reduce
_SETTLED, _SETTLED_PAIRS = 10, 4  # fits of a whole log that are fitted to the end, single and in pairs
_NEAR = 10.0  # multiples of the limit, within which a fit is weighed by its own derivatives
_INVOLVED = 1e-3  # length of the part of a direction that counts
_COARSEST_TURN = 0.1  # rad, of a step of the exact flow
_MAX_STEPS = 400  # between two samples
_SINGLE = "the round-off of float32"
ALL = 0.9999
"""Share of the differences from which on faults count as explaining all of them."""

LIBRARY_STEPS = 10
"""The most steps between two samples for which all maps of the library are tried."""


@dataclass(frozen=True)
class FittedParameter:
    """A number of a fault with its 95 % interval."""

    name: str
    unit: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class FittedFault:
    """A fault with its parameters, in words.

    undetermined: directions in which its parameters can change without an effect on the motion.
    """

    name: str
    kind: str
    sentence: str
    parameters: tuple[FittedParameter, ...]
    confirm: str
    undetermined: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class Diagnosis:
    """What explains a motion.

    verdict: explained, nearest (the faults leave more than round-off and another map of the same order
    would), healthy (the motion is that of the map, without a fault), lower-order (the same, but the map is
    of a lower order than the method), strapdown (the attitude is integrated from an omega that is
    right), this-scene-only (faults explain it, but another scene of the run refutes them), elsewhere (the
    steps are right, although the method is wrong), or unexplained. base: the map that the faults change.
    faults: one or two. share: of the differences from the map, over one sample interval, that the faults
    explain. alike: other faults that this scene cannot distinguish from them. nearly: the nearest faults of
    an unexplained motion. before, after: root mean square of the differences, over their scales;
    round_off: their round-off, or 1 where they are whitened (whitening.py). order: of the method, where the
    verdict is lower-order. start: how a recording begins off its scenario. equal_maps: other known maps that
    make the same motion, to the digits of a recording. within: these digits in words, or the noise that is in
    their place. is_within_noise: whether there is noise. per_sample: the largest difference
    from the exact motion over one sample interval, of an exact motion that is not exact to the digits.
    refuted_by: the scene in which the faults would act, and do not. fits: of the faults and of alike.
    """

    verdict: str
    base: str
    base_words: str
    faults: tuple[FittedFault, ...] = ()
    share: float = 0.0
    alike: tuple[str, ...] = ()
    alike_names: tuple[tuple[str, ...], ...] = ()
    nearly: tuple[FittedFault, ...] = ()
    before: float = 0.0
    after: float = 0.0
    round_off: float = 0.0
    order: int | None = None
    start: StartDifference | None = None
    equal_maps: tuple[str, ...] = ()
    within: str = ""
    is_within_noise: bool = False
    per_sample: float | None = None
    refuted_by: str = ""
    fits: tuple[Fit, ...] = field(default=(), repr=False, compare=False)
    circumstances: FaultContext | None = field(default=None, repr=False, compare=False)

    @property
    def fault_names(self) -> frozenset[str]:
        """The names of the faults."""
        return frozenset(fault.name for fault in self.faults)

    def with_fits(self, fits: Sequence[Fit]) -> Diagnosis:
        """Return the diagnosis with the faults of the first fit, and those of the others alike."""
        return replace(
            self,
            faults=_described(fits[0]),
            alike=tuple("; and ".join(one.sentence for one in _described(fit)) for fit in fits[1:]),
            alike_names=tuple(tuple(fault.name for fault in fit.faults) for fit in fits[1:]),
            fits=tuple(fits),
        )

    @property
    def without_faults(self) -> Diagnosis:
        """The diagnosis of a motion that is unexplained, near to which the faults come."""
        return Diagnosis(
            "unexplained", self.base, self.base_words, nearly=self.faults, before=self.before,
            after=self.before, round_off=self.round_off, circumstances=self.circumstances,
        )  # fmt: skip

    @property
    def _of_order(self) -> str:
        """Return " of order 2", that of the map; "" for the exact flow."""
        known = BASES.get(self.base) or TREE_MAPS.get(self.base)
        return "" if known is None or known is EXACT else f" of order {known.order}"

    @property
    def sentence(self) -> str:
        """The faults in one sentence, with those that would explain the motion as well."""
        if self.verdict == "healthy":
            within = f", to {self.within}" if self.within else ""
            if self.per_sample is not None:
                off = number(self.per_sample, 2)
                within = f" to a relative {off} per sample, as a solver with that tolerance gives"
            order = self._of_order and f",{self._of_order}"
            equal = _equal(self.equal_maps)
            if self.within == _SINGLE:
                return f"no fault but {_SINGLE}: the motion is that of {self.base_words}{order}"
            return f"no fault: the motion is that of {self.base_words}{order}{within}{equal}"
        if self.verdict == "strapdown":
            omega = "omega is that of the exact motion" + (f", to {self.within}" if self.within else "")
            rule = f"{self.base_words}{_equal(self.equal_maps)}"
            return f"no fault in omega: {omega}; the attitude is integrated from it: {rule}"
        if self.verdict == "lower-order":
            return f"the method is{self._of_order}, not {self.order}: the motion is that of {self.base_words}"
        if self.verdict == "elsewhere":
            steps = f"the single steps of this case are right, those of {self.base_words}"
            return f"{steps}: the cause acts at other steps, or within many steps that one call makes"
        if self.verdict not in ("explained", "nearest", "this-scene-only"):
            return "unexplained: no known fault, and no pair of the nearest, makes this motion"
        named = "; or ".join(["; and ".join(fault.sentence for fault in self.faults), *self.alike])
        if self.verdict == "this-scene-only":
            return f"explains this scene only: {named}; {self.refuted_by} refutes it for the engine"
        lead = "nearest known fault: " if self.verdict == "nearest" else ""
        return f"{lead}{named} (explains {_percent(self.share)} of the error)"


def _equal(equal_maps: Sequence[str]) -> str:
    maps = [map_in_words(name) for name in equal_maps]
    if len(maps) <= _LISTED:
        return f"; equal to these digits: {names(maps)}" if maps else ""
    return f"; {len(maps)} other known maps are equal to these digits, such as {names(maps[:2])}"


def _percent(share: float) -> str:
    """Return a share rounded down, so that what is not all is not 100 %."""
    return "all" if share > ALL else f"{math.floor(1e4 * share) / 100.0:g} %"


def bases_for(order: int | None) -> tuple[Base, ...]:
    """Return the common maps that a method of this order may be, those of the same order first."""
    if order is None:
        return tuple(COMMON.values())
    if order == 1:
        return tuple(base for base in COMMON.values() if base.order == 1)
    higher = (base for base in COMMON.values() if base.order > 1)
    return tuple(sorted(higher, key=lambda base: base.order != order))


def diagnosed(
    scene: Scene,
    trajectory: Trajectory,
    scales: Scales,
    dt_s: float | None,
    *,
    order: int | None = None,
    known: frozenset[str] = ALL_QUANTITIES,
    known_faults: Sequence[tuple[str, ...]] = (),
    known_map: str = "",
) -> Diagnosis | None:
    """Return what explains a trajectory; None where it cannot be examined.

    dt_s: the step of the method; None if it has none or is unknown. order: of the method. known: the
    quantities that the trajectory has. known_faults: names of faults that are tried first. known_map: the
    map of the library that the method is, where there is one, tried after the common ones. Not examined are
    callback loads, gravity gradients about a pivot, and motions with too many steps between two samples.
    """
    if obstacle(scene, trajectory, known) or "attitude" not in known:
        return None
    with np.errstate(all="ignore"):
        search = Search.of(scene, trajectory, scales, dt_s, known)
        if search is None:
            return None
        bases = bases_for(order) if dt_s is not None else (EXACT,)
        if dt_s is not None and known_map in LIBRARY:
            bases = (*bases, LIBRARY[known_map])
        return search.diagnosis(bases, known_faults, order)


def obstacle(scene: Scene, trajectory: Trajectory, known: frozenset[str]) -> str:
    """Return why a motion cannot be examined; "" where it can be.

    The attitude may be missing where the rotation does not depend on it.
    """
    if len(trajectory.t_s) < 2:
        return "a single sample"
    if scene.has_callback_load:
        return "the scenario has a load of kind callable"
    if scene.pivot is not None and any(isinstance(load, GravityGradient) for load in scene.loads):
        return "the scenario has a gravity gradient about a pivot"
    if "omega" not in known:
        return "there is no omega, and no other reading of the attitude brings it to the truth"
    loads = Grid.between(scene, trajectory.t_s[:2], 1).loads
    depends = bool(
        loads.kinds & {"torque_world", "moment"} or scene.continuous_loads or scene.pivot is not None
    )
    if "attitude" not in known and depends:
        return "there is no attitude, on which the loads of the scenario depend"
    return ""


@dataclass(frozen=True, eq=False)
class Search:
    """The transitions of a case on the grid of its own steps, if any, and on one for the exact flow.

    faults: those that are tried.
    """

    own: Transitions | None
    fine: Transitions | None
    faults: Sequence[Fault] = FAULTS

    @classmethod
    def of(
        cls,
        scene: Scene,
        trajectory: Trajectory,
        scales: Scales,
        dt_s: float | None,
        known: frozenset[str],
        resolution: Resolution = NOT_RECORDED,
        *,
        from_rows: bool = False,
        faults: Sequence[Fault] = FAULTS,
    ) -> Search | None:
        """Return the search; None where there are too many steps between two samples."""
        own = fine = None

        def on(grid: Grid, base: Base) -> Transitions:
            found = Transitions.of(scene, trajectory, grid, scales, known, resolution, from_rows=from_rows)
            return found.whitened_by(base) if found.is_coarse else found

        if dt_s is not None and steps_per_sample(scene.sample_interval_s, dt_s) <= _MAX_STEPS:
            own = on(Grid.of(scene, dt_s), BASES["midpoint"])
        speed = largest_norm(trajectory.omega_body)
        finest = _COARSEST_TURN / speed if speed > 0.0 else math.inf
        if math.isfinite(speed):
            stride = max(4.0, np.ceil(np.max(np.diff(trajectory.t_s)) / finest))
            if stride <= _MAX_STEPS:
                fine_grid = Grid.between(scene, trajectory.t_s, int(stride))
                fine = on(fine_grid, EXACT)
        return None if own is None and fine is None else cls(own, fine, faults)

    def with_steps(self, count: int) -> Search:
        """Return the search with so many steps between two samples, without the exact flow."""
        assert self.own is not None
        grid = Grid.of(self.own.scene, self.own.scene.sample_interval_s / count)
        own = replace(self.own, grid=grid, whitening=None, whole=None)
        return Search(own.whitened_by(BASES["midpoint"]) if own.is_coarse else own, None)

    @property
    def _knows_library(self) -> bool:
        """Whether the maps of the library are tried: not about a pivot, and for few steps per sample."""
        return self.own is not None and self.own.scene.pivot is None and self.own.grid.stride <= LIBRARY_STEPS

    @cached_property
    def matches(self) -> list[Base]:
        """The maps of the library that could have made the motion."""
        return maps_of(self.own) if self.own is not None and self._knows_library else []

    def on(self, base: Base) -> Transitions | None:
        """Return the transitions on which a map is run."""
        return self.fine if base is EXACT else self.own

    def diagnosis(
        self, bases: Sequence[Base], known_faults: Sequence[tuple[str, ...]], order: int | None
    ) -> Diagnosis:
        """Choose the map, then the faults."""
        usable = [base for base in bases if self.on(base) is not None] or [EXACT]
        candidates = [(self._healthy_cost(base), base) for base in usable]
        _, base = min(candidates, key=lambda pair: pair[0])
        if self.is_healthy(base):
            return self._without_fault(base, usable, order)
        if own := [one for one in self.matches if not _is_below(one, order)] or self.matches:
            return self._without_fault(own[0], own, order)
        for one in usable:
            if (known := self._known(one, known_faults)) is not None:
                return known
        if len(usable) > 1:
            base, is_exact = self._best_base(usable)
            if not is_exact and base is not EXACT and self._knows_library:
                base = self._library_base(base, order) or base
        found = self._with_base(base)
        if found.verdict == "explained" and found.share <= ALL:
            few = self._subset(base, _SCREENED)
            if found.after > max(few.limit, self._error_of_maps(base, bases)):
                return replace(found, verdict="nearest")
        return found

    def _error_of_maps(self, base: Base, bases: Sequence[Base]) -> float:
        """Return the differences of a map from the exact flow, which another map of its order may leave.

        Of the exact flow, those of the first map of the method; without a step, of one step per sample.
        """
        if base is not EXACT:
            few = self._subset(base, _SCREENED)
        else:
            assert self.fine is not None
            scene, t_s = self.fine.scene, self.fine.trajectory.t_s
            grid = Grid.between(scene, t_s, 1) if self.own is None else self.own.grid
            few = _few(replace(self.fine, grid=grid), _SCREENED)
            base = next((one for one in bases if one is not EXACT), BASES["m1"])
        return few.cost_of(_healthy(few, base) - _healthy(few, EXACT))

    def _without_fault(self, base: Base, usable: Sequence[Base], order: int | None) -> Diagnosis:
        """Return the diagnosis of the motion of a map, or of one that this motion cannot tell from it."""
        if _is_below(base, order):
            alike = (one for one in usable if not _is_below(one, order) and self.is_healthy(one))
            base = next(alike, base)
        cost, seen = self._healthy_cost(base), self._subset(base, _FITTED)
        found = Diagnosis(
            "healthy", base.name, base.text, before=cost, after=cost, round_off=seen.round_off,
            within=_SINGLE if seen.is_single else "",
        )  # fmt: skip
        return replace(found, verdict="lower-order", order=order) if _is_below(base, order) else found

    def _known(self, base: Base, known_faults: Sequence[tuple[str, ...]]) -> Diagnosis | None:
        """Return the diagnosis with faults that are already known, if they leave nothing but round-off."""
        few, full = self._subset(base, _SCREENED), self._subset(base, _FITTED)
        at = self._context(base, few)
        by_name = {fault.name: fault for fault in FAULTS if fault.could_change(at)}
        for known in known_faults:
            if not by_name.keys() >= set(known):
                continue
            faults = tuple(by_name[name] for name in known)
            # one of two faults may have no effect here, such as a limit that is not reached
            singles = fitted(few, base, at, [one for fault in faults for one in _combined((fault,), at)])
            best = min(singles, key=lambda fit: _score(fit, few))
            if best.cost <= few.limit:
                return self._conclusion(base, few, full, [best], [])
            if len(faults) > 1:
                pairs = fitted(few, base, at, _combined(faults, at))
                if pairs[0].cost <= few.limit:
                    return self._conclusion(base, few, full, [best], pairs)
        return None

    def _best_base(self, bases: Sequence[Base]) -> tuple[Base, bool]:
        """Return the first map with which a single fault leaves round-off, else the map that it fits best.

        And whether it leaves round-off.
        """
        candidates = [(base, general) for general in (False, True) for base in bases]
        if bases[0].order > 1:  # of the method's own order, so it comes first with general faults, too
            candidates.remove((bases[0], True))
            candidates.insert(1, (bases[0], True))
        costs: list[float] = []
        first: dict[tuple[int, bool], list[Start]] = {}
        for base, general in candidates:
            fits = self._first_look(base, first.get((base.order, general)), general=general)
            costs.append(fits[0].cost)
            if base.order > 1:  # maps of a higher order differ little, so that the same faults fit
                leaders: list[Start] = [(fit.faults, tuple(fit.values)) for fit in fits[:_SAME_LEADERS]]
                first.setdefault((base.order, general), leaders)
            if costs[-1] <= self._subset(base, _FIRST_LOOK).limit:
                return base, True
            best, _ = candidates[int(np.argmin(costs))]
            if base is bases[-1] and min(costs) <= (1.0 - _EXPLAINED) * self._healthy_cost(best):
                break
        lowest = min(costs)
        pairs = zip(costs, candidates, strict=False)
        return next(base for cost, (base, _) in pairs if cost <= 1.2 * lowest), False

    def _library_base(self, nearest: Base, order: int | None) -> Base | None:
        """Return the map of the library with which a single fault leaves round-off.

        None if there is none, or if a general fault of the nearest map does.

        A fault changes a step of all maps nearly alike. What it changes in the nearest map, taken off the
        differences from every other map, leaves least with the right one. This is repeated from there. A map
        that is nearer without a fault than others with one shows which faults to try.
        """
        few = self._subset(nearest, _FIRST_LOOK)
        limit, whole = few.limit, few if few.whole is None else few.whole
        maps = [one for one in LIBRARY.values() if not _is_below(one, order)]
        if (formulation := self._with_weights(maps, few)) is not None:
            return formulation
        sound = whole.weighted(whole.gaps_after(whole.after(maps)))
        base, tried, lowest = nearest, {nearest.name}, math.inf
        starts: list[Start] | None = None
        for _ in range(_NEIGHBOURS):
            if self._healthy_cost(base) < lowest:
                starts = None
            fits = self._first_look(base, starts, general=False)
            lowest = min(lowest, fits[0].cost)
            if starts is None:
                fits = sorted([*fits, *self._first_look(base, None, general=True)], key=lambda fit: fit.cost)
            if fits[0].cost <= limit:
                if base not in maps:  # the nearest common map, with a general fault
                    return None
                # of maps that are equal here, the first one
                equal = (whole.cost_of(own - sound[maps.index(base)]) <= whole.least for own in sound)
                return next(one for one, is_equal in zip(maps, equal, strict=True) if is_equal)
            fits = fits[:_SAME_LEADERS]
            starts = [(fit.faults, tuple(fit.values)) for fit in fits]
            here = _healthy(self._subset(base, _FIRST_LOOK), base)
            left = np.min([_left(sound + (fit.remaining - here), fit.slopes) for fit in fits], axis=0)
            possible = [maps[k] for k in np.argsort(left)]
            own = [one for one in maps if could_act(fits[0].faults, self._context(one, few))]
            is_slip = len(own) < len(maps) and fits[0].cost <= _NEARLY_ALL * self._healthy_cost(base)
            if is_slip:  # of a tableau: it acts differently in formulations that are near without it
                possible = [*own[:_FORMULATIONS], *possible]
            elif np.min(left) > _NO_NEARER * min(float(np.linalg.norm(fit.remaining)) for fit in fits):
                return None
            nearer = (one for one in possible if one.name not in tried)
            if (base := next(nearer, base)).name in tried:
                return None
            tried.add(base.name)
        return None

    def _with_weights(self, maps: Sequence[Base], few: Transitions) -> Base | None:
        """Return the first map of which a tableau with other weights leaves round-off."""
        flexible = [fault for fault in self.faults if fault.is_flexible]
        able = ((one, starts) for one in maps if (starts := _starts(flexible, self._context(one, few))))
        tried = islice(able, _FORMULATIONS)
        return next((one for one, starts in tried if self._first_look(one, starts, general=True)), None)

    def _subset(self, base: Base, max_count: int) -> Transitions:
        transitions = self.on(base)
        assert transitions is not None
        return _few(transitions, max_count)

    def _first_look(self, base: Base, starts: Sequence[Start] | None, *, general: bool) -> list[Fit]:
        """Return the best fits of a single fault, specific or general, on a few transitions.

        starts: from which the fits start; None: from those of all faults.
        """
        few = self._subset(base, _FIRST_LOOK)
        at = self._context(base, few)
        # leaders of another map may be slips of a tableau that this one does not have
        starts = [start for start in starts or () if could_act(start[0], at)]
        starts = starts or [start for start in _starts(self.faults, at) if start[0][0].is_general == general]
        fits = sorted(fitted(few, base, at, starts, sweeps=_FIRST_SWEEPS), key=lambda fit: fit.cost)
        found = [*self._settled(base, few, fits[:_LEADERS]), *fits[_LEADERS:]]
        return sorted(_named(found, few), key=lambda fit: fit.cost)

    def _settled(self, base: Base, few: Transitions, fits: Sequence[Fit]) -> list[Fit]:
        """Return fits that are fitted to the end: where the whole log counts, to all of it.

        Each is then weighed by the derivatives of its own map, if these could decide about it.
        """
        starts: list[Start] = [(fit.faults, tuple(fit.values)) for fit in fits]
        if few.whitening is None:
            return fitted(few, base, self._context(base, few), starts)
        whole = self._subset(base, _FITTED)
        at, healthy = self._context(base, whole), whole.grid.model(whole.scene)
        found = fitted(whole, base, at, starts)
        for index, fit in enumerate(found):
            if whole.limit / _NEAR < fit.cost <= _NEAR * whole.limit:
                own = whole.whitened_by(base, planted(at, healthy, fit.faults, fit.values))
                (found[index],) = fitted(own, base, at, [(fit.faults, tuple(fit.values))])
        return found

    def _healthy_cost(self, base: Base) -> float:
        few = self._subset(base, _FIRST_LOOK)
        return few.cost_of(_healthy(few, base))

    def is_healthy(self, base: Base) -> bool:
        """Whether a map without faults leaves nothing but round-off."""
        transitions = self._subset(base, _FITTED)
        if transitions.whitening is not None:
            transitions = transitions.whitened_by(base)
        return transitions.cost_of(_healthy(transitions, base)) <= transitions.limit

    def _context(self, base: Base, transitions: Transitions) -> FaultContext:
        return FaultContext(transitions, base)

    def _with_base(self, base: Base) -> Diagnosis:
        few, full = self._subset(base, _SCREENED), self._subset(base, _FITTED)
        at = self._context(base, few)
        fits = fitted(few, base, at, _starts(self.faults, at))
        singles = _named(self._sorted(base, few, fits, _SETTLED), few)
        best = singles[0]
        pairs: list[Fit] = []
        is_exact = best.cost <= few.limit
        if best.is_general or not is_exact:
            # where a general fault explains all, two of fewer parameters say more
            parts = [fit for fit in singles if not fit.faults[0].is_flexible]
            ones = [fit for fit in parts if fit.complexity < best.complexity] if is_exact else parts
            starts = _pair_starts(ones, at, general=is_exact)
            pairs = self._sorted(base, few, fitted(few, base, at, starts), _SETTLED_PAIRS)
            # a pair that leaves little of a motion may have one right fault, which was not the best alone
            small = (1.0 - _EXPLAINED) * few.cost_of(_healthy(few, base))
            if others := _exchanged(pairs[0], parts, at, every=few.limit < pairs[0].cost <= small):
                more = self._sorted(base, few, fitted(few, base, at, others), _SETTLED_PAIRS)
                pairs = sorted([*pairs, *more], key=lambda fit: _score(fit, few))
            if substitutes := _substitutes(pairs[0], parts):
                pairs += self._settled(base, few, fitted(few, base, at, substitutes))
        return self._conclusion(base, few, full, singles, pairs)

    def _sorted(self, base: Base, few: Transitions, fits: Iterable[Fit], settled: int) -> list[Fit]:
        """Return fits, the best first; settled: so many of them to the end, where the whole log counts."""
        found = sorted(fits, key=lambda fit: _score(fit, few))
        if few.whitening is not None:
            found[:settled] = self._settled(base, few, found[:settled])
            found.sort(key=lambda fit: _score(fit, few))
        return found

    def _conclusion(
        self, base: Base, few: Transitions, full: Transitions, singles: Sequence[Fit], pairs: Sequence[Fit]
    ) -> Diagnosis:
        before, round_off = few.cost_of(_healthy(few, base)), few.round_off
        best, rivals = singles[0], singles
        if pairs:
            pair = pairs[0]
            is_as_good = pair.cost <= few.limit and pair.complexity < best.complexity
            is_better = is_as_good or _BETTER * pair.cost < best.cost
            if base is EXACT and _share(best, before) >= _EXPLAINED:
                # what a single fault leaves may be the error of a method whose step is unknown
                is_better &= pair.cost <= few.limit
            if _share(pair, before) >= _EXPLAINED and is_better:
                best, rivals = pair, pairs
        described = Diagnosis(
            "unexplained", base.name, base.text, before=before, after=before, round_off=round_off,
            circumstances=self._context(base, full),
        )  # fmt: skip
        is_noise = bool(few.resolution.noise) and best.cost <= few.limit  # all that is left
        explains = _share(best, before) >= (_EXPLAINED_TO_NOISE if is_noise else _EXPLAINED)
        if explains and best.cost > few.limit and few.resolution.is_stated:
            explains = self._share_elsewhere(base, best) >= _EXPLAINED_ELSEWHERE
        if not explains:
            if self._share_elsewhere(base, singles[0]) < _NEARLY:
                return described
            return replace(described, nearly=_described(singles[0]))
        equivalent = _equivalent(best, rivals, few)
        if len(best.faults) > 1 and len(equivalent) > _MAX_PAIRS:
            return described
        found = replace(described, verdict="explained", share=_share(best, before), after=best.cost)
        return found.with_fits(self._refitted(base, full, [best, *equivalent]))

    def _share_elsewhere(self, base: Base, fit: Fit) -> float:
        """Return the share of the differences that faults explain where they are not fitted."""
        whole = self.on(base)
        assert whole is not None
        middle = round(_FITTED_PART * len(whole.indices))
        if middle < 1 or middle == len(whole.indices):
            return 0.0
        parts = [whole.part(slice(None, middle)), whole.part(slice(middle, None))]
        if whole.whitening is not None:
            parts = [part.whitened_by(base) for part in parts]
        first, second = (part.subset(_FITTED) for part in parts)
        starts: list[Start] = [(fit.faults, tuple(fit.values))]
        (fine,) = fitted(first, base, self._context(base, first), starts)
        at = self._context(base, second)
        model = planted(at, second.grid.model(second.scene), fine.faults, fine.values)
        after = second.cost_of(second.differences([model], base)[0])
        before = second.cost_of(_healthy(second, base))
        return 1.0 - after / before if before > 0.0 else 0.0

    def _refitted(self, base: Base, full: Transitions, equivalent: Sequence[Fit]) -> list[Fit]:
        """Return the fits on more transitions, without those that these tell from the best one."""
        found = self._settled(base, full, equivalent)
        if found[0].cost > full.limit:
            found.sort(key=lambda fit: _score(fit, full))
        return [found[0], *_equivalent(found[0], found[1:], full)]


_LISTED = 4  # maps
_APART = 5.0  # deviations, by which noise tells one fault from another
_MAX_PAIRS = 6  # more pairs that fit equally well are no explanation


def _few(transitions: Transitions, max_count: int) -> Transitions:
    """Return at most so many transitions, more of them where the whole log counts."""
    if transitions.whitening is not None:
        max_count = _FITTED_OF_LOG if max_count == _FITTED else _SCREENED_OF_LOG
    return transitions.subset(max_count)


def _is_below(base: Base, order: int | None) -> bool:
    """Whether a map is of a lower order than a method; the exact flow stands for all orders."""
    return order is not None and base is not EXACT and base.order < order


def could_act(faults: Iterable[Fault], at: FaultContext) -> bool:
    """Return whether each of some faults could change a motion."""
    return all(fault.could_change(at) for fault in faults)


def _healthy(transitions: Transitions, base: Base) -> Array:
    return transitions.differences([transitions.grid.model(transitions.scene)], base)[0]


def _left(differences: Array, slopes: Array) -> Array:
    """Return the norms of differences (m, 12, n), less what the parameters of a fit can change of them."""
    rows = differences.reshape(len(differences), -1)
    if slopes.size:
        axes = np.linalg.qr(slopes)[0]
        rows = rows - (rows @ axes) @ axes.T
    return np.asarray(np.linalg.norm(rows, axis=-1))


def _share(fit: Fit, before: float) -> float:
    """Return the share of the differences, beyond what a right candidate leaves, that a fit explains."""
    least = fit.transitions.least**2
    rest, whole = max(fit.cost**2 - least, 0.0), before**2 - least
    return 1.0 - math.sqrt(rest / whole) if whole > 0.0 else 0.0


def _named(fits: Iterable[Fit], transitions: Transitions) -> list[Fit]:
    """Return fits without flexible faults that leave more than round-off."""
    return [fit for fit in fits if not fit.faults[0].is_flexible or fit.cost <= transitions.limit]


def _score(fit: Fit, transitions: Transitions) -> float:
    """Return the decades of the cost, above round-off, with a charge for parameters."""
    lowest = transitions.round_off * (3.0 if transitions.whitening is None else 1.0)
    # what noise leaves is known: a fit that leaves more is wrong, however few parameters it has
    wrong = bool(transitions.resolution.noise) and fit.cost > transitions.limit
    return math.log10(max(fit.cost, lowest)) + _PARAMETER_COST * fit.complexity + wrong


def _starts(faults: Iterable[Fault], at: FaultContext) -> list[Start]:
    possible = (fault for fault in faults if fault.could_change(at))
    return [((fault,), start) for fault in possible for start in fault.starts(at)]


def _combined(faults: tuple[Fault, ...], at: FaultContext) -> list[Start]:
    """Return every combination of the starts of some faults."""
    starts = product(*(fault.starts(at) for fault in faults))
    return [(faults, [value for start in each for value in start]) for each in starts]


def _pair_starts(singles: Sequence[Fit], at: FaultContext, *, general: bool) -> list[Start]:
    """Return the pairs of the eight best single faults, and those of the best one with all specific faults.

    general: with all general faults instead.
    """
    leaders = _distinct(singles)[:_PAIRED]
    found = {}
    for one, other in combinations(leaders, 2):
        found[one.faults[0].name, other.faults[0].name] = (one, other)
    for one in leaders[:1]:
        for other in singles:
            if other is not one and other.is_general == general:
                names = one.faults[0].name, other.faults[0].name
                if names[::-1] not in found:
                    found[names] = (one, other)
    starts: list[Start] = []
    for one, other in found.values():
        both = (*one.faults, *other.faults)
        starts += [(both, (*one.values, *second)) for second in other.faults[0].starts(at)]
    return starts


def _substitutes(pair: Fit, singles: Sequence[Fit]) -> list[Start]:
    """Return the pairs in which faults stand for those that make the same motion alone."""
    by_name = {fit.faults[0].name: fit for fit in singles}
    choices: list[list[tuple[Fault, Array]]] = []
    for fault, values in pair.parts:
        alone = by_name[fault.name]
        same = (fit for fit in singles if fit is not alone and _is_same(fit, alone))
        choices.append([(fault, values), *((fit.faults[0], fit.values) for fit in same)])
    return [
        ((one, other), (*values, *more))
        for (one, values), (other, more) in list(product(*choices))[1:]
        if one is not other
    ]


def _exchanged(pair: Fit, singles: Sequence[Fit], at: FaultContext, *, every: bool) -> list[Start]:
    """Return the pairs in which a specific fault stands for a general one; every: for either fault."""
    found: list[Start] = []
    for index, (fault, _) in enumerate(pair.parts):
        rest, values = pair.parts[1 - index]
        if every or (fault.is_general and not rest.is_general):
            others = (one.faults[0] for one in singles if not one.is_general)
            own = (one for one in others if one not in (fault, rest))
            found += [((one, rest), (*start, *values)) for one in own for start in one.starts(at)]
    return found


def _is_same(one: Fit, other: Fit) -> bool:
    """Whether two fits leave the same differences."""
    return _gap(one, other) <= _SAME_EFFECT * other.cost


def _distinct(fits: Sequence[Fit]) -> list[Fit]:
    """Return the fits without those that make the same motion as a better one."""
    found: list[Fit] = []
    for fit in fits:
        if not any(_is_same(fit, other) for other in found):
            found.append(fit)
    return found


def _gap(one: Fit, other: Fit) -> float:
    return float(np.sqrt(np.mean((one.remaining - other.remaining) ** 2)))


def _equivalent(best: Fit, rivals: Iterable[Fit], transitions: Transitions) -> list[Fit]:
    """Return the other fits that explain the trajectory as well.

    Where the best one leaves round-off, these make the same motion: the scene cannot distinguish them. Fits
    with more parameters contain the best one.
    """
    if transitions.resolution.noise:  # then the likelihoods decide, as of normal errors
        apart = _APART / math.sqrt(best.remaining.size)
        limit = min(max(best.cost, transitions.limit), math.hypot(best.cost, apart))
    else:
        limit = _TIE * max(best.cost, transitions.limit)
    found: dict[frozenset[str], Fit] = {}
    for fit in rivals:
        if fit.cost <= limit and fit.complexity <= best.complexity + 1:
            found.setdefault(fit.names, fit)
    found.pop(best.names, None)
    return list(found.values())


def _described(fit: Fit) -> tuple[FittedFault, ...]:
    widths, found, first = fit.half_widths, [], 0
    for fault, values in fit.parts:
        parameters = []
        free = fit.undetermined[:, first : first + len(values)]
        own = widths[first : first + len(values)]
        stated = np.where(np.isfinite(own) & (np.abs(values) <= own), 0.0, values)
        if len(values) > 1:  # of several, some may be right
            healthy = np.array([parameter.healthy for parameter in fault.parameters])
            stated = np.where(np.isfinite(own) & (np.abs(stated - healthy) <= own), healthy, stated)
        for parameter, value in zip(fault.parameters, values, strict=True):
            width = float(widths[first])
            first += 1
            parameters.append(
                FittedParameter(parameter.name, parameter.unit, float(value), value - width, value + width)
            )
        found.append(
            FittedFault(
                fault.name,
                fault.kind,
                fault.text(stated),
                tuple(parameters),
                fault.confirm,
                tuple(tuple(row) for row in free.tolist() if np.linalg.norm(row) > _INVOLVED),
            )
        )
    return tuple(found)
