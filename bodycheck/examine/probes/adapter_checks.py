"""The conformance suite of an adapter: one list of checks, each of which describes what is wrong.

The checks use the requests of the worker protocol only, so that they apply to engines of every kind. They
need no truth: a scene at several steps has a limit, and the limit must obey the formula of each load.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Engine, Method, ReadBack, read_back_mismatch
from bodycheck.adapters.execution import Answer, Case
from bodycheck.examine.probes.finding import Finding, FindingLimit, Sampled, limit, noise
from bodycheck.examine.probes.probe import Probe, arithmetic_eps, built_in_probes, motions_of
from bodycheck.examine.probes.reading_mistakes import Mistake, part_of, read_back_mistake, reading_mistake
from bodycheck.examine.probes.readings import reading_findings
from bodycheck.examine.probes.responses import response_findings
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, linear_momentum
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, KeyForm
from bodycheck.reference_impl.rotations import geodesic_angle, rotate
from bodycheck.reference_impl.scene import CallbackLoad, Link, Load, PointForce, Scene, Torque
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.case import RunCase


@dataclass(frozen=True, eq=False)
class CheckBench:
    """One method under test; record, replay: requests of the worker protocol."""

    engine: Engine
    method: Method
    record: RunCase
    replay: RunCase

    def case(self, scene: Scene, dt_s: float) -> Case:
        """Return the case of a scene at a step."""
        return Case(scene, self.method.name, self.method.setting(dt_s))

    def accepted(self, scene: Scene, dt_s: float) -> Scene:
        """Return the scene; if the engine refuses it, without loads, or also without gravity."""
        free = replace(scene, loads=())
        for simpler in (scene, free, replace(free, gravity=np.zeros(3))):
            if self.record(self.engine, self.case(simpler, dt_s)).outcome != "unsupported":
                return simpler
        return scene

    def motions(self, scene: Scene, steps_s: Sequence[float]) -> Motions:
        """Return the motions at these steps, with the identified mistake of the readings undone."""
        made = self._made(scene, steps_s)
        mistake = self._free[2]
        if mistake is None:
            return made
        undone = tuple(replace(one, trajectory=mistake.undone(one.trajectory)) for one in made.motions)
        return replace(made, motions=undone)

    def _made(self, scene: Scene, steps_s: Sequence[float]) -> Motions:
        for shorter in (1.0, _SHORTER):  # an explicit method may be unstable at steps that suit others
            probe = Probe("", scene, tuple(shorter * dt_s for dt_s in steps_s))
            found = motions_of(probe, self.engine, self.method, self.record)
            if not found.reason.startswith("unstable"):
                break
        return Motions(found.motions, found.resolution, found.reason)

    @cached_property
    def _free(self) -> tuple[Motions, tuple[Finding, ...], Mistake | None]:
        """The motions of the free probe, its findings, and the mistake that explains them."""
        probe = built_in_probes()[1]
        made = self._made(self.accepted(probe.scene, probe.steps_s[0]), probe.steps_s)
        if not made.motions:
            return made, (), None
        with np.errstate(all="ignore"):
            findings = tuple(reading_findings(made.motions, made.resolution))
            return made, findings, reading_mistake(made.motions, made.resolution, findings)

    @cached_property
    def readings(self) -> tuple[Finding, ...]:
        """The findings of the free probe; those that one mistake explains are its first alone."""
        made, findings, mistake = self._free
        if not made.motions:
            return (_without_motion("readings", made.reason),)
        return findings if mistake is None else tuple(_explained(findings, mistake))

    @cached_property
    def loads(self) -> tuple[Finding, ...]:
        """The findings of the probe under loads."""
        return tuple(_load_findings(self, built_in_probes()[0].scene))

    @cached_property
    def failed(self) -> frozenset[str]:
        """The failed checks of readings and loads."""
        both = (*self.readings, *self.loads)
        return frozenset(finding.check for finding in both if finding.verdict == "inconsistent")


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of a scene, coarsest step first, and their relative round-off; or why there are none."""

    motions: tuple[Sampled, ...]
    resolution: float
    reason: str


@dataclass(frozen=True)
class Check:
    """One requirement of the contract: what must hold, and the findings that show whether it does.

    after: checks whose failure can make this one fail too.
    """

    name: str
    requirement: str
    findings: Callable[[CheckBench], Iterator[Finding]]
    after: tuple[str, ...] = ()


_LINK = Link(np.array([0.2, -0.15, 0.1]), np.array([0.8, 0.2, -0.4, 0.4]))
_PIVOT = np.array([0.1, -0.2, 0.15])
_DURATION_S, _STEPS_S = 0.32, (1e-2, 5e-3, 2.5e-3, 1.25e-3)
_ORDER_STEPS_S = (4e-2, 2e-2, 1e-2)
_MISSING_ORDER = 0.5
_ABOVE_ROUND_OFF = 1e3
_MIN_SHARE = 1e-3
_FAST_M_S = np.array([300.0, -100.0, 200.0])  # beyond the speed at which some engines clamp
_SHORTER = 0.125
_KEEPS_SIZE = 1e-5  # a smaller change of a factor would not show in six digits
_REPEAT = 16.0  # multiples of the round-off of the motion


def _slow_scene(*loads: Load) -> Scene:
    """Return a body that rotates by about 0.8 rad, with loads and without gravity."""
    free = built_in_probes()[1].scene
    start = replace(free.initial, omega_body=np.array([1.2, -2.0, 0.9]))
    return Scene(free.body, start, loads, np.zeros(3), _DURATION_S, 2)


# ------------------------------------------------------------------------------------------- the model held


def _model(bench: CheckBench) -> Iterator[Finding]:
    """Compare what the adapter reads back with the scene, for the probes and for a link frame."""
    probe = built_in_probes()[1]
    scene = bench.accepted(probe.scene, probe.scene.sample_interval_s)
    for name, variant in (("read_back", scene), ("read_back_of_link", replace(scene, link=_LINK))):
        case = bench.case(variant, variant.sample_interval_s)
        answer = bench.record(bench.engine, case)
        if not isinstance(answer.read_back, ReadBack):
            yield _unanswered(name, answer)
            continue
        dt_s = case.setting.dt_s
        mismatch = read_back_mismatch(variant, dt_s, answer.read_back, bench.method.precision) or ""
        text = mismatch and read_back_mistake(variant, dt_s, answer.read_back)
        wrong = float(bool(mismatch))
        yield Finding(name, wrong, 0.0, wrong, 0.0, f"{text}: {mismatch}" if text else mismatch)


def _read_back_reads(bench: CheckBench) -> Iterator[Finding]:
    """Compare the read-back after the last step with the last sample."""
    name = "read_back_after_steps"
    if bench.method.control != "dt":
        yield Finding(name, message="a method without steps has no state between samples")
        return
    case = _repeated(bench)
    first, again = bench.record(bench.engine, case), bench.replay(bench.engine, case)
    if first.trajectory is None or first.read_back is None or again.read_back is None:
        yield _unanswered(name, again)
        return
    before, after = first.read_back, again.read_back
    stale = [
        quantity for quantity, value in _state_of(after).items() if _echoes(first.trajectory, quantity, value)
    ]
    changed = [
        quantity for quantity in ("mass", "inertia", "dt_s", "gravity")
        if not np.array_equal(getattr(before, quantity), getattr(after, quantity))
    ]  # fmt: skip
    text = [f"{quantity} {_ECHOED}" for quantity in stale[:1]]
    text += [f"{quantity} read back changes while the engine steps" for quantity in changed]
    wrong = float(bool(text))
    yield Finding(name, wrong, 0.0, wrong, 0.0, "; ".join(text))


_ECHOED = (
    "read back after the last step is not that of read(): "
    "read_back returns what the adapter was given, not what the engine holds"
)
_COLUMNS = {
    "position": "position_m",
    "velocity": "velocity_m_s",
    "quaternion": "quaternion",
    "rotation": "rotation",
    "omega_world": "omega_world_rad_s",
    "omega_body": "omega_body_rad_s",
}


def _state_of(read_back: Any) -> Mapping[str, Array]:
    return {quantity: value for quantity, value in vars(read_back.state).items() if value is not None}


def _echoes(path: Trajectory, quantity: str, value: Array) -> bool:
    """Whether a quantity that was read back after the last step differs from the last sample."""
    read = getattr(path, _COLUMNS[quantity])
    if read is None:
        return False
    moved = float(np.max(np.abs(read[-1] - read[0])))
    return moved > 0.0 and float(np.max(np.abs(value - read[-1]))) > 1e-3 * moved


# --------------------------------------------------------------------------------------- readings and loads


_CONSERVED = ("angular_momentum_change", "rotational_energy_change")


def _readings(bench: CheckBench) -> Iterator[Finding]:
    yield from (finding for finding in bench.readings if finding.check not in _CONSERVED)


def _explained(findings: Sequence[Finding], mistake: Mistake) -> Iterator[Finding]:
    """Yield the findings, with one failure in words in place of all that the mistake explains."""
    text: str = mistake.text
    for finding in findings:
        if finding.verdict != "inconsistent":
            yield finding
        elif text and finding.check in mistake.checks:
            yield replace(finding, message=text)
            text = ""


def _free_motion(bench: CheckBench) -> Iterator[Finding]:
    """Yield the changes of what a motion without loads conserves: the probe, and a long one."""
    slow = _slow_scene()
    scene = replace(slow, initial=replace(slow.initial, velocity=_FAST_M_S))
    made = bench.motions(scene, _STEPS_S)
    if not made.motions:
        yield _without_motion("free_motion", made.reason)
        return
    yield from (finding for finding in bench.readings if finding.check in _CONSERVED)
    for name, load in (("linear", "force"), ("angular", "torque")):
        momenta = [_momenta(motion)[name == "angular"] for motion in made.motions]
        size = float(np.linalg.norm(momenta[-1][0]))
        changes = [(momentum[-1] - momentum[0])[np.newaxis] / size for momentum in momenta]
        scatter = len(momenta[-1]) * noise(momenta[-1]) / size
        found = limit([m.dt_s for m in made.motions], changes, max(made.resolution, scatter))
        factor = float(np.linalg.norm(momenta[-1][0] / size + found.value[0]))
        text = f"without a {load} the {name} momentum changes by {found.size:.3g} of its size"
        if abs(factor - 1.0) > _KEEPS_SIZE:
            text = f"without a {load} the {name} momentum becomes {factor:.6g} times as large"
        if 0.5 < factor < 1.0 and 1.0 - factor > 0.5 * found.size:  # it shrinks rather than turns
            text += f", as under a damping of {-np.log(factor) / scene.duration_s:.3g} 1/s"
        yield found.finding(f"{name}_momentum_change", text)


def _momenta(motion: Sampled) -> tuple[Array, Array]:
    """Return P and L over time, (n, 3)."""
    body, path = motion.scene.body, motion.trajectory
    return (
        linear_momentum(body.mass, path.velocity_m_s),
        angular_momentum(path.rotation_matrices, body.inertia, path.omega_body),
    )


def _loads(bench: CheckBench) -> Iterator[Finding]:
    yield from bench.loads


def _load_findings(bench: CheckBench, scene: Scene) -> Iterator[Finding]:
    made = bench.motions(scene, built_in_probes()[0].steps_s)
    if not made.motions:
        yield _without_motion("loads", made.reason)
        return
    with np.errstate(all="ignore"):
        yield from response_findings(made.motions, made.resolution)


def _link(bench: CheckBench) -> Iterator[Finding]:
    """Yield readings and loads for a link frame off the centre of mass, without what failed before."""
    loaded, free = (replace(probe.scene, link=_LINK) for probe in built_in_probes())
    made = bench.motions(free, built_in_probes()[1].steps_s)
    findings = [*_link_readings(made), *_load_findings(bench, loaded)]
    for finding in findings:
        if finding.check not in bench.failed:
            yield replace(finding, check=f"link_{finding.check}")


def _link_readings(made: Motions) -> Iterator[Finding]:
    if not made.motions:
        yield _without_motion("readings", made.reason)
        return
    with np.errstate(all="ignore"):
        findings = list(reading_findings(made.motions, made.resolution))
        mistake = reading_mistake(made.motions, made.resolution, findings)
    yield from findings if mistake is None else _explained(findings, mistake)


_CONSTANTS: Mapping[KeyForm, Any] = {
    "number": 3.0,
    "positive": 30.0,
    "not negative": 0.5,
    "vector": np.array([1.4, -0.8, 1.8]),
    "damping matrix": np.diag([0.5, 0.8, 0.3]),
    "axes": "body",
}


def _continuous_loads() -> Iterator[ContinuousLoad]:
    """Yield one load of each kind that acts throughout, except users' functions."""
    for kind in load_kinds().values():
        if issubclass(kind, ContinuousLoad) and kind is not CallbackLoad:
            yield kind(**{name: _CONSTANTS[key.form] for name, key in kind.keys().items()})


def _continuous(bench: CheckBench) -> Iterator[Finding]:
    """Yield the momentum gained under each continuous load alone against the integral of its formula."""
    for load in _continuous_loads():
        name = f"{load.kind}_impulse"
        made = bench.motions(_slow_scene(load), _STEPS_S)
        if not made.motions:
            yield _without_motion(name, made.reason)
            continue
        yield _impulse_finding(name, f"the {load.kind}", made.motions, made.resolution)


def _impulse_finding(name: str, load_name: str, motions: Sequence[Sampled], resolution: float) -> Finding:
    """Return P and L gained against the integral of force and torque, relative to that integral."""
    gained, impulse = (
        np.array(values) for values in zip(*(_balance(motion) for motion in motions), strict=True)
    )
    size = np.linalg.norm(impulse[-1], axis=-1, keepdims=True)  # of force and of torque
    size = np.where(size > 0.0, size, np.max(size))
    path = motions[-1].trajectory
    body = motions[-1].scene.body
    states = [body.mass * path.velocity_m_s, body.inertia.max() * path.omega_body]
    scatter = max(len(values) * noise(values) + resolution * np.max(np.abs(values)) for values in states)
    found = limit([m.dt_s for m in motions], (gained - impulse) / size, float(scatter / np.min(size)))
    return found.finding(name, _impulse_words(load_name, found, impulse[-1] / size))


def _balance(motion: Sampled) -> tuple[Array, Array]:
    """Return the gained momenta and the integrals of the wrench, (2, 3): linear, then angular."""
    scene, path = motion.scene, motion.trajectory
    at = Instants(path.t_s, path.position_m, path.rotation_matrices, path.velocity_m_s, path.omega_world)
    wrenches = [load.wrench(scene, at) for load in scene.continuous_loads]
    rates = [sum(part) for part in zip(*wrenches, strict=True)]
    integrals = [np.trapezoid(rate, dx=motion.dt_s, axis=0) for rate in rates]
    return np.array([momentum[-1] - momentum[0] for momentum in _momenta(motion)]), np.array(integrals)


def _impulse_words(load_name: str, found: FindingLimit, along: Array) -> str:
    shares = [
        (name, 1.0 + float(excess @ unit))
        for name, excess, unit in zip(("linear", "angular"), found.value, along, strict=True)
        if np.any(unit)
    ]
    if all(abs(share) <= max(found.tolerance, _MIN_SHARE) for _, share in shares):
        return f"{load_name} has no effect: apply it, or refuse it in `unsupported`"
    gained = " and ".join(
        f"the {name} momentum gained is {share:.6g} times its impulse" for name, share in shares
    )
    across = found.value - np.sum(found.value * along, axis=-1, keepdims=True) * along
    perpendicular = float(np.linalg.norm(across))
    also = (
        f", plus {perpendicular:.3g} times its size perpendicular to it"
        if perpendicular > found.tolerance
        else ""
    )
    return f"{load_name} acts wrongly: {gained}{also}"


def _pivot(bench: CheckBench) -> Iterator[Finding]:
    """Yield how far the pivot moves, relative to its distance from the centre of mass."""
    free = _slow_scene()
    start = free.initial
    velocity = rotate(start.quaternion, np.cross(start.omega_body, -_PIVOT))
    gravity = built_in_probes()[0].scene.gravity
    scene = replace(free, initial=replace(start, velocity=velocity), gravity=gravity, pivot=_PIVOT)
    made = bench.motions(scene, _STEPS_S)
    if not made.motions:
        yield _without_motion("pivot", made.reason)
        return
    motions = made.motions
    arm, moved = float(np.linalg.norm(_PIVOT)), []
    for motion in motions:
        path = motion.trajectory
        pivot_path = path.position_m + path.rotation_matrices @ _PIVOT
        moved.append((pivot_path[-1] - pivot_path[0])[np.newaxis] / arm)
    size = float(np.max(np.abs(motions[-1].trajectory.position_m)))
    found = limit([m.dt_s for m in motions], moved, made.resolution * size / arm)
    text = f"the pivot moves by {found.size:.3g} times its distance from the centre of mass"
    yield found.finding("pivot", f"{text}: hold it, or refuse it in `unsupported`")


# --------------------------------------------------------------------------------------------------- stages


def _stages(bench: CheckBench) -> Iterator[Finding]:
    """Yield the orders without loads and under each, against the method's statements."""
    method = bench.method
    if method.control != "dt" or method.order is None:
        yield Finding("order", message="the method states no order")
        return
    yield _order_finding(bench, "order", (), method.order, "")
    at_stages = {"torque and force": method.torque, "continuous loads": method.continuous_loads}
    for name, loads, kind in _STAGED:
        stated = at_stages[kind]
        if stated == "every stage":
            text = f"; the method states that {kind} are evaluated at every stage, but they are held constant"
            yield _order_finding(bench, f"{name}_order", loads, method.order, f"{text} over the step")


_BODY_TORQUE = Torque("body", np.array([6.0, -8.0, 5.0]), 0.0, np.inf)
_WORLD_TORQUE = Torque("world", np.array([-4.0, 7.0, 9.0]), 0.0, np.inf)
_BODY_FORCE = PointForce("body", np.array([25.0, 10.0, -20.0]), np.array([0.2, -0.3, 0.1]), 0.0, np.inf)
_WORLD_FORCE = PointForce("world", np.array([-15.0, 20.0, 30.0]), np.array([-0.1, 0.25, 0.2]), 0.0, np.inf)
_SMOOTH = tuple(load for load in _continuous_loads() if load.kind in ("sine-torque", "drag"))
_STAGED: tuple[tuple[str, tuple[Load, ...], str], ...] = (
    ("body_torque", (_BODY_TORQUE,), "torque and force"),
    ("world_torque", (_WORLD_TORQUE,), "torque and force"),
    ("body_force", (_BODY_FORCE,), "torque and force"),
    ("world_force", (_WORLD_FORCE,), "torque and force"),
    *((load.kind, (load,), "continuous loads") for load in _SMOOTH),
)
"""(name, loads, which statement of the method applies)"""


def _order_finding(bench: CheckBench, name: str, loads: tuple[Load, ...], stated: int, cause: str) -> Finding:
    """log2 |y_4h - y_2h| / |y_2h - y_h| of the last states, which must not be below the stated order."""
    scene = _slow_scene(*loads)
    ends = []
    for dt_s in _ORDER_STEPS_S:
        answer = bench.record(bench.engine, bench.case(scene, dt_s))
        if answer.trajectory is None:
            return _unanswered(name, answer)
        ends.append(answer.trajectory)
    eps = np.finfo(np.float64 if bench.method.precision == "float64" else np.float32).eps
    resolution = _DURATION_S / _ORDER_STEPS_S[-1] * float(eps)
    coarse, fine = (_distance(one, other) for one, other in pairwise(ends))
    if fine <= _ABOVE_ROUND_OFF * resolution:
        return Finding(name, message="the differences between steps are round-off")
    order = float(np.log2(coarse / fine))
    short = max(stated - order, 0.0)
    message = "" if short <= _MISSING_ORDER else f"the order is {order:.2f}, not {stated}{cause}"
    return Finding(name, order, float(stated), short, _MISSING_ORDER, message)


def _distance(one: Trajectory, other: Trajectory) -> float:
    """Return the distance of the last states: the angle, and the relative distances of the vectors."""
    angle = float(np.max(geodesic_angle(one.attitude[-1:], other.attitude[-1:])))
    found = [angle]
    for name in ("position_m", "velocity_m_s", "omega_body"):
        a, b = getattr(one, name)[-1], getattr(other, name)[-1]
        size = float(np.linalg.norm(b))
        if size > 0.0:
            found.append(float(np.max(np.abs(a - b))) / size)
    return max(found)


# ------------------------------------------------------------------------------------- reset, advance, input


def _repeated(bench: CheckBench) -> Case:
    """Return a case with every kind of constant load; of a free motion if the engine refuses loads."""
    loaded, free = built_in_probes()
    dt_s = loaded.steps_s[0]
    if bench.accepted(loaded.scene, dt_s) is loaded.scene:
        return bench.case(loaded.scene, dt_s)
    return bench.case(bench.accepted(free.scene, free.steps_s[0]), free.steps_s[0])


def _reset(bench: CheckBench) -> Iterator[Finding]:
    """Yield the distance between a motion and the same motion after `reset`."""
    timed = _slow_scene(*(load for load in _SMOOTH if load.kind == "sine-torque"))
    timed = replace(timed, samples=33)
    for name, case in (("reset", _repeated(bench)), ("reset_of_time", bench.case(timed, 1e-2))):
        first, again = bench.record(bench.engine, case), bench.replay(bench.engine, case)
        if first.trajectory is None or again.trajectory is None:
            yield _unanswered(name, again if again.trajectory is None else first)
            continue
        yield _repeat_finding(bench, name, first.trajectory, again.trajectory, _after_reset)


def _after_reset(quantity: str, sample: int) -> str:
    if sample == 0:
        return f"reset does not restore the {quantity}"
    return (
        f"after reset the {quantity} differs from sample {sample} on: reset keeps a time, a load or a cache"
    )


def _advance(bench: CheckBench) -> Iterator[Finding]:
    """Yield the distance between advance(n) and n times advance(1)."""
    if bench.method.control != "dt":
        yield Finding("advance", message="a method without steps")
        return
    for name, loads in (("advance", (_BODY_TORQUE, _WORLD_FORCE)), ("advance_under_sine", _SMOOTH[-1:])):
        scene = _slow_scene(*loads)
        if name == "advance":
            scene = bench.accepted(scene, 1e-2)
        paths = []
        for samples in (33, 17, 2):
            answer = bench.record(bench.engine, bench.case(replace(scene, samples=samples), 1e-2))
            if answer.trajectory is None:
                yield _unanswered(name, answer)
                break
            paths.append(answer.trajectory)
        else:
            single = part_of(paths[0], slice(None, None, 2))
            found = _repeat_finding(bench, name, single, paths[1], _in_one_call(2))
            if found.verdict == "consistent":
                ends = part_of(paths[0], slice(None, None, 32))
                found = _repeat_finding(bench, name, ends, paths[2], _in_one_call(32))
            yield found


def _in_one_call(steps: int) -> Callable[[str, int], str]:
    return lambda quantity, _: f"advance({steps}) differs from {steps} times advance(1) in the {quantity}"


def _repeat_finding(
    bench: CheckBench, name: str, one: Trajectory, other: Trajectory, text: Callable[[str, int], str]
) -> Finding:
    """Return the largest relative difference of the engine's own numbers; text: of (quantity, sample)."""
    worst, message = 0.0, ""
    tolerance = _REPEAT * 33.0 * arithmetic_eps(one, bench.method.precision)
    earliest = len(one.t_s)
    for quantity, column in _COLUMNS.items():
        a, b = getattr(one, column), getattr(other, column)
        if a is None or b is None:
            continue
        difference = np.abs(a - b).reshape(len(a), -1).max(axis=1) / np.max(np.abs(a))
        worst = max(worst, float(np.max(difference)))
        first = int(np.argmax(difference > tolerance))
        if difference[first] > tolerance and first < earliest:
            earliest, message = first, text(quantity, first)
    return Finding(name, worst, 0.0, worst, tolerance, message)


def _bad_input(bench: CheckBench) -> Iterator[Finding]:
    """Yield whether a method that the engine does not have is refused, and whether the next case works."""
    dt_s = built_in_probes()[1].scene.sample_interval_s
    case = bench.case(bench.accepted(built_in_probes()[1].scene, dt_s), dt_s)
    before = bench.record(bench.engine, case)
    unknown = bench.record(bench.engine, replace(case, method="no-such-method"))
    accepted = float(unknown.trajectory is not None)
    message = "a method that the engine does not have is run" if accepted else ""
    yield Finding("unknown_method", accepted, 0.0, accepted, 0.0, message)
    if before.trajectory is None:
        yield _unanswered("after_refusal", before)
        return
    after = bench.record(bench.engine, case)
    missing = float(after.trajectory is None)
    message = f"after a refused case the next one is {after.outcome}: {after.message}" if missing else ""
    yield Finding("after_refusal", missing, 0.0, missing, 0.0, message)


def _unanswered(name: str, answer: Answer) -> Finding:
    return _without_motion(name, f"{answer.outcome}: {answer.message}")


def _without_motion(name: str, reason: str) -> Finding:
    """Return a refusal as not measured, and any other reason as a failure."""
    wrong = None if reason.startswith("unsupported") else 1.0
    return Finding(name, wrong, 0.0, wrong, 0.0, reason)


_MOTION = ("model", "readings", "free motion")
CHECKS: Sequence[Check] = (
    Check("model", "the engine holds the mass, inertia, step, gravity and state that it was given", _model),
    Check("read-back", "read_back returns what the engine holds, also after steps", _read_back_reads),
    Check(
        "readings", "omega and velocity are the derivatives of attitude and position", _readings, ("model",)
    ),
    Check(
        "free motion",
        "without loads, linear and angular momentum are constant",
        _free_motion,
        ("model", "readings"),
    ),
    Check("loads", "each constant load alone gives its impulse", _loads, _MOTION),
    Check(
        "link", "readings and loads are those of the centre of mass in body axes", _link, (*_MOTION, "loads")
    ),
    Check(
        "continuous loads",
        "each continuous load alone gives its impulse, or is refused",
        _continuous,
        (*_MOTION, "loads"),
    ),
    Check("pivot", "the pivot stays in place, or is refused", _pivot, (*_MOTION, "loads")),
    Check(
        "stages",
        "loads are evaluated at the stages, where the method states it",
        _stages,
        (*_MOTION, "loads", "continuous loads"),
    ),
    Check("reset", "the same motion after reset", _reset),
    Check("advance", "advance(2) equals twice advance(1)", _advance, ("reset",)),
    Check("bad input", "wrong requests are refused, and the next case works", _bad_input),
)
"""All checks, in the order of the report: the causes before their consequences."""
