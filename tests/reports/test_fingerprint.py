"""Identification of a method's one-step map from single steps, and the leading error of an unknown map."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodycheck.adapters.contract import Build, Engine, Method, ReadBack, Reading, Setting
from bodycheck.adapters.execution import Answer, Case
from bodycheck.examine.probes import examination
from bodycheck.examine.probes.examination import check_replays
from bodycheck.examine.probes.fingerprint import (
    FARTHER,
    Fingerprint,
    distances,
    fingerprint_of,
    fingerprint_row,
    steps_along,
)
from bodycheck.examine.probes.laws import LAWS, REVERSE, STATES, Checked, check_laws, law_rows
from bodycheck.examine.probes.tree_laws import TREE_LAWS
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps import EXACT, MAPS, formula_of
from bodycheck.reference_impl.one_step_maps.first_order import first_order_maps
from bodycheck.reference_impl.one_step_maps.lie_group import lie_group_maps
from bodycheck.reference_impl.one_step_maps.one_step_map import (
    Loads,
    Motion,
    Solid,
    Step,
    held_acceleration,
    scene_loads,
)
from bodycheck.reference_impl.one_step_maps.runge_kutta_maps import runge_kutta_maps
from bodycheck.reference_impl.rotations import geodesic_angle, normalised
from bodycheck.reference_impl.scene import RigidBody, Scene, State, Torque
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.document import Sentence
from bodycheck.reports.run_files.method_words import (
    LAW_NAMES,
    NO_KNOWN_MAP,
    NOT_MEASURED,
    OTHER_BITS,
    REPLAY,
    SAME_BITS,
    identified,
)
from bodycheck.reports.summary.method_identity import fingerprint_document, laws_document
from bodycheck.runs.engine_checks import laws
from tests.helpers.changed_package import copy_with, printed_by
from tests.helpers.scenario_texts import tumbling

ROOT = Path(__file__).parents[2]
BY_ALIAS = {alias: one for one in MAPS.values() for alias in (one.name, *one.aliases)}


def no_loads(*motion: Array) -> tuple[Array, Array]:
    """Return zero force and torque, with the shape of the angular velocity."""
    *_, omega = motion
    return np.zeros_like(omega), np.zeros_like(omega)


METHOD = Method("under-test", "", 1, 1, "zero-order hold", "", "")
ENGINE = Engine("numpy", "1", {METHOD.name: METHOD})


def stepping(step: Step, *, altered: Callable[[Scene], Scene] = lambda scene: scene) -> Callable[..., Answer]:
    """Return a numpy engine that makes these steps, in a scene that it may misread."""

    def ask(engine: Engine, case: Case) -> Answer:
        del engine
        scene, dt_s = altered(case.scene), case.setting.dt_s
        assert dt_s is not None
        start, stride = scene.initial, round(scene.sample_interval_s / dt_s)
        state = Motion(
            np.zeros(1), start.position[None], start.velocity[None], start.quaternion[None],
            start.omega_body[None],
        )  # fmt: skip
        solid, loads, found = Solid.of(scene.body), scene_loads(scene), [state]
        for _ in range(scene.samples - 1):
            for _ in range(stride):
                state = step(solid, state, np.array([dt_s]), loads)
            found.append(state)
        path = Trajectory(
            case.scene.sample_times,
            np.concatenate([one.position for one in found]),
            np.concatenate([one.velocity for one in found]),
            quaternion=np.concatenate([one.quaternion for one in found]),
            omega_body_rad_s=np.concatenate([one.omega for one in found]),
        )
        held = case.scene
        reading = Reading(
            held.initial.position, held.initial.velocity, held.initial.quaternion,
            omega_body=held.initial.omega_body,
        )  # fmt: skip
        return Answer(
            "ok", "", path, ReadBack(held.body.mass, held.body.inertia, dt_s, held.gravity, reading)
        )

    return ask


def found_for(step: Step) -> Fingerprint:
    """Return the fingerprint of a method that makes these steps."""
    return fingerprint_of(ENGINE, METHOD, stepping(step))


@pytest.mark.slow
@pytest.mark.nightly(after=13)
@pytest.mark.parametrize(
    "name",
    [
        "M1", "M2", "M3", "M4", "explicit Euler", "implicit midpoint", "no gyroscopic term", "Jolt",
        "PhysX 5", "RK4, additive quaternion", "RK4 Munthe-Kaas",
        "RK4 on the rotation group, stages averaged", "CF4",
        "Buss 2000, order 2 augmented", "Moser-Veselov", "SPIRAL", "splitting6",
    ],
)  # fmt: skip
def test_a_planted_map_is_named_and_the_runner_up_is_a_thousand_times_farther(name: str) -> None:
    """Each map is identified from its own steps, without loads and under each constant load."""
    one = BY_ALIAS[name]
    found = found_for(one.step)
    assert found.name == one.name
    assert found.agreement is not None
    assert found.runner_up_distance is not None
    assert found.agreement < 1e-12
    assert found.runner_up_distance > FARTHER * found.agreement


def capped_substeps(solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
    """Return what four substeps make, under accelerations of the start, with |omega| dt at most pi/4."""
    held, speed = held_acceleration(solid, loads, motion), float(np.linalg.norm(motion.omega))
    motion = replace(motion, omega=motion.omega * min(1.0, math.pi / 4.0 / (speed * float(dt[0]))))
    for _ in range(4):
        motion = BY_ALIAS["PhysX 5"].step(solid, motion, dt / 4.0, held)
    return motion


@pytest.mark.slow
def test_a_map_with_a_speed_limit_is_named_by_its_slow_steps() -> None:
    """Substeps under held accelerations, with |omega| dt limited to pi/4, are those of a known map."""
    found = found_for(capped_substeps)
    name = "rescaled momentum, torque first, 4 steps per step"
    assert found.name == f"{name}, |omega| dt below pi/4, zero-order hold of accelerations in world axes"
    assert found.agreement is not None
    assert found.agreement < 1e-12
    assert formula_of(f"{name}; a remark").endswith("w = omega+; a remark")


@pytest.mark.slow
def test_no_two_maps_of_the_library_are_the_same() -> None:
    """At |omega| dt = 1 under torques, any two maps that store the same attitude differ by 1e-10."""
    solid = Solid(np.asarray(3.0), np.array([[0.8, 0.1, -0.15], [0.1, 1.0, 0.05], [-0.15, 0.05, 1.2]]))
    start = Motion(
        np.zeros(1), np.zeros((1, 3)), np.ones((1, 3)), np.array([[0.5, -0.1, 0.7, 0.5]]),
        np.array([[0.5, -0.7, 0.4]]),
    )  # fmt: skip
    loads = scene_loads(
        Scene(
            RigidBody(3.0, solid.inertia),
            State(np.zeros(3), np.array([0.5, -0.1, 0.7, 0.5]), np.ones(3), np.zeros(3)),
            (Torque("body", np.array([0.3, -0.2, 0.1])), Torque("world", np.array([0.1, 0.4, -0.2]))),
            np.zeros(3),
            1.0,
            2,
        )
    )
    images = {}
    for name, one in MAPS.items():
        if one.attitude not in ("matrix", "projected matrix"):
            with np.errstate(all="ignore"):  # an implicit step may overflow on its way to the solution
                after = one.step(solid, start, np.array([1.0]), loads)
            images[name] = np.concatenate([after.quaternion[0], after.omega[0]])
    same = [
        (a, b) for a, b in combinations(images, 2) if float(np.max(np.abs(images[a] - images[b]))) < 1e-10
    ]
    assert not same


def test_free_steps_have_the_order_that_the_library_states() -> None:
    """The error of one step of every map falls by 2^(order + 1) when the step is halved."""
    inertia = np.array([[1.0, 0.1, -0.05], [0.1, 2.0, 0.2], [-0.05, 0.2, 2.6]])
    solid, draw, count = Solid(np.asarray(1.0), inertia), np.random.default_rng(1), 32
    still, attitude = np.zeros((count, 3)), normalised(draw.normal(size=(count, 4)))
    start = Motion(np.zeros(count), still, still, attitude, draw.normal(size=(count, 3)))
    steps = {
        order: 0.4 if order > 5 else 0.05 if order > 3 else 0.02 if order == 3 else 0.004
        for order in range(9)
    }
    exacts = {
        h: EXACT.step(solid, start, np.full(count, h), no_loads)
        for coarse in set(steps.values())
        for h in (coarse, coarse / 2)
    }
    for name, one in MAPS.items():
        if one is EXACT:
            continue
        matrices = start.orthogonal if "matrix" in one.attitude else None
        coarse, errors = steps[one.order], []
        for h in (coarse, coarse / 2):
            after = one.step(solid, replace(start, rotation=matrices), np.full(count, h), no_loads)
            exact = exacts[h]
            angle = geodesic_angle(after.quaternion, exact.quaternion)
            errors.append(np.mean(angle**2 + np.sum((after.omega - exact.omega) ** 2, axis=-1)))
        found = np.log2(errors[0] / errors[1]) / 2.0 - 1.0
        near = 0.5 if one.order < 5 else 0.97  # where round-off allows only steps with terms of higher order
        assert -0.5 < found - one.order < near, name


def test_what_the_library_states_of_a_map_holds_for_its_steps() -> None:
    """Of all maps: time advances, reversible ones return, attitudes are rotations where they say so."""
    draw, count = np.random.default_rng(1), 8
    solid = Solid(np.asarray(1.0), np.array([[1.0, 0.1, -0.05], [0.1, 2.0, 0.2], [-0.05, 0.2, 2.6]]))
    attitude = normalised(draw.normal(size=(count, 4)))
    position, velocity, omega = draw.normal(size=(3, count, 3))
    start, h = Motion(np.full(count, 0.3), position, velocity, attitude, omega), np.full(count, 0.1)
    asked = 0

    def drag(*motion: Array) -> tuple[Array, Array]:
        nonlocal asked
        asked += 1
        *_, velocity, omega = motion
        return -0.1 * velocity, -0.1 * omega

    for name, one in MAPS.items():
        begin = replace(start, rotation=start.orthogonal if "matrix" in one.attitude else None)
        end = one.step(solid, begin, h, no_loads)
        assert np.allclose(end.t, start.t + h, rtol=1e-15), name
        norms = np.max(np.abs(np.linalg.norm(end.quaternion, axis=-1) - 1.0))
        assert norms < 1e-13 or one.attitude == "quaternion", name
        assert (end.rotation is not None) is ("matrix" in one.attitude), name
        if end.rotation is not None:
            gram = end.rotation @ np.swapaxes(end.rotation, -1, -2)
            assert np.max(np.abs(gram - np.eye(3))) < 1e-13 or one.attitude == "matrix", name
        if one.reversible:
            back = one.step(solid, replace(end, omega=-end.omega, velocity=-end.velocity), h, no_loads)
            assert np.max(geodesic_angle(back.quaternion, start.quaternion)) < 1e-12, name
            assert np.allclose(back.omega, -start.omega, rtol=0.0, atol=1e-12), name
        asked = 0
        one.step(solid, begin, h, drag)
        assert (asked > 1) is one.stages, name


def test_names_of_maps_are_unique() -> None:
    """A second map of one name would take the place of the first."""
    names = [one.name for one in (EXACT, *first_order_maps(), *runge_kutta_maps(), *lie_group_maps())]
    assert sorted(names) == sorted(MAPS)


@pytest.mark.slow
def test_an_unknown_map_is_described_by_its_leading_error() -> None:
    """M1 with a drag torque of -0.04 I omega is unknown, of order 0, with the error -0.04 omega dt."""

    def damped(solid: Solid, motion: Motion, dt: np.ndarray, loads: object) -> Motion:  # type: ignore[type-arg]
        after = MAPS["M1"].step(solid, motion, dt, loads)  # type: ignore[arg-type]
        return replace(after, omega=after.omega * (1.0 - 0.04 * dt[:, None]))

    found = found_for(damped)
    assert found.name == NO_KNOWN_MAP
    assert found.leading is not None
    assert round(found.leading.order) == 0
    assert found.leading.omega["omega"] == pytest.approx(-0.04, rel=0.05)
    assert found.residual == 0.0  # the distance to another map excuses no violation


@pytest.mark.nightly
@pytest.mark.parametrize("gain", [1e3, 1e40, 1e150, 1e300])
def test_a_map_that_diverges_is_unknown_or_not_measured(gain: float) -> None:
    """Many maps cannot be evaluated at states whose energy grows beyond all bounds."""

    def step(solid: Solid, state: Motion, dt: Array, loads: Any) -> Motion:
        after = BY_ALIAS["M1"].step(solid, state, dt, loads)
        return replace(after, omega=after.omega * gain)

    with np.errstate(all="ignore"):
        found = found_for(step)
    assert found.name in (NO_KNOWN_MAP, NOT_MEASURED)
    assert found.message


def test_a_map_that_does_not_exist_for_a_state_is_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """An implicit step may have no solution; the maps that have one are compared nevertheless."""
    missing = BY_ALIAS["M2"]

    def no_solution(solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
        return replace(missing.step(solid, motion, dt, loads), omega=np.nan * motion.omega)

    assert found_for(missing.step).name == missing.name
    monkeypatch.setitem(MAPS, missing.name, replace(missing, step=no_solution))
    assert found_for(BY_ALIAS["M1"].step).name == BY_ALIAS["M1"].name
    assert found_for(missing.step).name != missing.name


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("spin", [80.0, 1e4, 1e160, np.inf])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_step_without_a_solution_is_no_error(spin: float) -> None:
    """Whatever the spin, each map returns a state, of NaN where its equations are singular."""
    inertia = np.array([[0.05, 0.0003, -0.0002], [0.0003, 0.051, 0.0004], [-0.0002, 0.0004, 0.052]])
    dice, count = np.random.default_rng(1), 64
    omega = dice.normal(size=(count, 3))
    omega[: count // 2] *= spin
    attitude = normalised(dice.normal(size=(count, 4)))
    solid, none = Solid(np.ones(count), np.tile(inertia, (count, 1, 1))), np.zeros((count, 3))
    for one in MAPS.values():
        begin = Motion(np.zeros(count), none, none, attitude, omega)
        end = one.step(solid, begin, np.full(count, 0.01), lambda *_: (none, none))
        assert np.isfinite(end.omega[count // 2 :]).all(), one.name


def test_an_unrenormalised_quaternion_differs_from_a_renormalised_one() -> None:
    """The norm of the quaternion is compared, so M4 is not M1 with renormalisation."""
    scene = replace(STATES["free, |omega| dt = 0.3"][0], samples=2)
    scene = replace(scene, duration_s=scene.duration_s / 16)
    ask = stepping(MAPS["M1, additive quaternion"].step)
    answer = ask(ENGINE, Case(scene, METHOD.name, Setting(scene.duration_s)))
    assert answer.trajectory is not None
    steps = steps_along(scene, answer.trajectory)
    for name, near in (("M1, additive quaternion", True), ("M1, additive quaternion renormalised", False)):
        predicted = MAPS[name].step(steps.solid, steps.before, steps.dt, steps.loads)
        assert (float(np.max(distances(steps, predicted))) < 1e-14) is near


def laws_of(ask: Callable[..., Answer], again: Callable[..., Answer] | None = None) -> dict[str, Checked]:
    """Return the results of all laws by name."""
    return {one.law.name: one for one in check_laws(ENGINE, METHOD, ask, again or ask)}


@pytest.mark.slow
def test_a_sound_map_breaks_no_law() -> None:
    """M1 obeys every law, and its lack of reversibility is a property."""
    found = laws_of(stepping(MAPS["M1"].step))
    assert {name for name, one in found.items() if one.verdict != "holds"} == {REVERSE}
    assert found[REVERSE].verdict == "property"


def _world_inertia(scene: Scene) -> Scene:
    """Misread the inertia as given in world axes at the start."""
    turn = scene.initial.rotation
    return replace(scene, body=replace(scene.body, inertia=turn.T @ scene.body.inertia @ turn))


def _diagonal(scene: Scene) -> Scene:
    ordered = np.diag(np.diag(scene.body.inertia)) * np.array([1.0, 1.0, 1.5])
    return replace(scene, body=replace(scene.body, inertia=ordered))


def _pulled_to_the_origin(scene: Scene) -> Scene:
    return replace(scene, gravity=scene.gravity - 0.1 * scene.initial.position)


def _damped_start(scene: Scene) -> Scene:
    start = scene.initial
    return replace(scene, initial=replace(start, velocity=start.velocity * 0.9))


def _with_armature(scene: Scene) -> Scene:
    return replace(scene, body=replace(scene.body, inertia=scene.body.inertia + 0.01 * np.eye(3)))


def _ignores_offset(scene: Scene) -> Scene:
    if scene.link is None:
        return scene
    return replace(scene, body=replace(scene.body, inertia=1.01 * scene.body.inertia))


def _timed_drag(scene: Scene) -> Scene:
    spun = scene.initial.omega_body * (1.0 - 1e-3 * scene.duration_s)
    return replace(scene, initial=replace(scene.initial, omega_body=spun))


def _shorter_if_sampled_once(scene: Scene) -> Scene:
    return scene if scene.samples > 2 else replace(scene, gravity=scene.gravity + 0.1)


@pytest.mark.slow
@pytest.mark.nightly(after=2)
@pytest.mark.parametrize(
    ("law", "fault"),
    [
        ("rotate", _world_inertia),
        ("permute", _diagonal),
        ("link", _ignores_offset),
        ("boost", _damped_start),
        ("shift", _pulled_to_the_origin),
        ("scale-mass", _with_armature),
        ("scale-time", _timed_drag),
        ("split", _shorter_if_sampled_once),
    ],
)
def test_each_law_reports_a_fault_that_breaks_it(law: str, fault: Callable[[Scene], Scene]) -> None:
    """A planted fault that depends on the description of the scene breaks the law about this description."""
    found = laws_of(stepping(MAPS["M1"].step, altered=fault))
    assert found[law].verdict == "broken"
    assert found[law].message


def _in_fixed_axes(order: int) -> Step:
    """Return an accurate map with a local error of order + 1 in dt that depends on the body's axes."""

    def step(solid: Solid, motion: Motion, dt: Array, loads: Any) -> Motion:
        after = MAPS["RK4 Munthe-Kaas"].step(solid, motion, dt, loads)
        error = 0.1 * motion.omega ** (order + 2) * np.array([1.0, 0.0, 0.0])
        return replace(after, omega=after.omega + dt[:, None] ** (order + 1) * error)

    return step


def _in_absolute_time(order: int) -> Step:
    """Return an accurate map with a local error of order + 1 in dt whose size does not scale with time."""

    def step(solid: Solid, motion: Motion, dt: Array, loads: Any) -> Motion:
        after = MAPS["RK4 Munthe-Kaas"].step(solid, motion, dt, loads)
        return replace(after, omega=after.omega + dt[:, None] ** (order + 1) * np.array([2e-4, -1e-4, 1e-4]))

    return step


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("stated", "actual", "verdict"),
    [
        (2, 2, "property"),
        (2, 1, "broken"),
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in ((1, 1, "property"), (None, 1, "property"), (1, 0, "broken"))
        ),
    ],
)
@pytest.mark.parametrize(("law", "faulty"), [("permute", _in_fixed_axes), ("scale-time", _in_absolute_time)])
def test_a_violation_that_falls_with_the_step_like_the_error_is_a_property(
    law: str, faulty: Callable[[int], Step], stated: int | None, actual: int, verdict: str
) -> None:
    """A discretisation may depend on the description of the scene; what a finer step leaves is a fault."""
    method = replace(METHOD, order=stated, torque="every stage")
    engine = replace(ENGINE, methods={method.name: method})
    ask = stepping(faulty(actual))
    assert {one.law.name: one.verdict for one in check_laws(engine, method, ask, ask)}[law] == verdict


@pytest.mark.slow
def test_a_limit_that_ends_to_act_at_small_steps_breaks_a_law() -> None:
    """A largest change of omega per step, in rad/s, is no error that falls as a power of the step."""

    def limited(solid: Solid, motion: Motion, dt: Array, loads: Any) -> Motion:
        after = MAPS["M1"].step(solid, motion, dt, loads)
        change = after.omega - motion.omega
        size = np.linalg.norm(change, axis=-1, keepdims=True)
        return replace(after, omega=motion.omega + change * np.minimum(1.0, 0.4 / np.maximum(size, 1e-300)))

    assert laws_of(stepping(limited))["scale-time"].verdict == "broken"


@pytest.mark.nightly
def test_the_residual_of_a_solver_is_no_violation() -> None:
    """Implicit midpoint whose iteration stops at 1e-10 is reversible up to that."""

    def inexact(solid: Solid, motion: Motion, dt: Array, loads: Any) -> Motion:
        after = BY_ALIAS["implicit midpoint"].step(solid, motion, dt, loads)
        residual = 1e-11 * np.sin(1e3 * motion.omega) * np.linalg.norm(motion.omega)
        return replace(after, omega=after.omega + residual)

    ask = stepping(inexact)
    found = fingerprint_of(ENGINE, METHOD, ask)
    assert found.name == BY_ALIAS["implicit midpoint"].name
    assert found.reversible
    assert 1e-12 < found.residual < 1e-9
    for residual, verdict in ((0.0, "broken"), (found.residual, "property")):
        checked = check_laws(ENGINE, METHOD, ask, ask, reversible=True, residual=residual)
        (reverse,) = (one for one in checked if one.law.name == REVERSE)
        assert reverse.verdict == verdict
        assert ("loads that are held" in reverse.message) is (verdict == "property")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("share", "verdict"), [(lambda tol: 1e4 * tol, "property"), (lambda _: 1e-8, "broken")]
)
def test_a_violation_that_falls_with_the_tolerance_is_a_property(
    share: Callable[[float], float], verdict: str
) -> None:
    """An absolute tolerance gives slow motions larger relative errors than fast ones."""
    method = replace(METHOD, control="tolerance", order=None, tolerances=(1e-6, 1e-12))

    def ask(engine: Engine, case: Case) -> Answer:
        assert case.setting.tolerance is not None
        exact = EXACT.step
        error = share(case.setting.tolerance)

        def step(solid: Solid, motion: Motion, dt: Array, loads: Any) -> Motion:
            after = exact(solid, motion, dt, loads)
            return replace(after, omega=after.omega + error * np.array([1.0, 0.0, 0.0]))

        setting = Setting(case.scene.sample_interval_s)
        return stepping(step)(engine, replace(case, setting=setting))

    found = {one.law.name: one.verdict for one in check_laws(ENGINE, method, ask, ask)}
    assert found["scale-time"] == verdict
    assert found["repeat"] == "holds"


@pytest.mark.slow
def test_a_second_run_that_differs_breaks_repeat_alone() -> None:
    """An engine whose second run starts otherwise breaks `repeat`, and no other law."""
    again = stepping(MAPS["M1"].step, altered=_damped_start)
    found = laws_of(stepping(MAPS["M1"].step), again)
    assert [name for name, one in found.items() if one.verdict == "broken"] == ["repeat"]


def replayed(*ways: Callable[..., Answer]) -> Checked:
    """Return whether M1 has the same bits in further runs, the n-th of which is `way n`."""
    ask, numbered = stepping(MAPS["M1"].step), [(f"way {n}", way) for n, way in enumerate(ways, 1)]
    return check_replays(ENGINE, [METHOD], ask, numbered)[METHOD.name]


def test_replay_holds_where_every_run_has_the_same_bits() -> None:
    """The reported size is 0, which a gate can require."""
    same = stepping(MAPS["M1"].step)
    found = replayed(same, same)
    assert found.worst is not None
    assert (found.verdict, found.worst.size, found.message) == ("holds", 0.0, "")


@pytest.mark.parametrize(
    ("array", "quantity"),
    [
        ("position_m", "position"),
        ("velocity_m_s", "velocity"),
        ("quaternion", "attitude"),
        ("omega_body_rad_s", "omega"),
    ],
)
def test_replay_reports_one_bit_and_the_run_that_has_it(array: str, quantity: str) -> None:
    """One unit in the last place is a property; the message names the quantity and the run."""
    same = stepping(MAPS["M1"].step)

    def one_bit_off(engine: Engine, case: Case) -> Answer:
        answer = same(engine, case)
        assert answer.trajectory is not None
        changed = getattr(answer.trajectory, array).copy()
        changed[7, 1] = np.nextafter(changed[7, 1], np.inf)
        return replace(answer, trajectory=replace(answer.trajectory, **{array: changed}))

    found = replayed(same, one_bit_off)
    assert found.worst is not None
    assert found.verdict == "property"
    assert 0.0 < found.worst.size < 1e-15
    assert found.message.startswith(f"{quantity} differs by")
    assert "way 2" in found.message


def test_replay_is_not_measured_where_a_run_fails() -> None:
    """A method whose run fails, or is not repeated, has no verdict."""
    fails = lambda engine, case: Answer("failed", "gone")  # noqa: E731, ARG005 - the shortest possible engine
    assert replayed(fails).verdict == "not-measured"
    assert check_replays(ENGINE, [METHOD], fails, [])[METHOD.name].message == "failed: gone"


def test_replay_runs_twice_as_long_with_the_samples_of_the_other_laws() -> None:
    """A longer motion shows more; its step must still divide the sampling interval."""
    cases: list[Case] = []
    same = stepping(MAPS["M1"].step)

    def recording(engine: Engine, case: Case) -> Answer:
        cases.append(case)
        return same(engine, case)

    check_replays(ENGINE, [METHOD], recording, [("again", same)])
    (case,) = cases
    lengths = {(scene.sample_interval_s, 2.0 * scene.duration_s): dt_s for scene, dt_s in STATES.values()}
    assert lengths[case.scene.sample_interval_s, case.scene.duration_s] == case.setting.dt_s


def test_replay_starts_from_a_state_that_the_method_supports() -> None:
    """The next state is tried if one is unsupported; a run that fails ends the attempts."""
    same, requested = stepping(MAPS["M1"].step), 0

    def refusing_one(engine: Engine, case: Case) -> Answer:
        nonlocal requested
        requested += 1
        return Answer("unsupported", "too fast") if requested == 1 else same(engine, case)

    assert check_replays(ENGINE, [METHOD], refusing_one, [("again", same)])[METHOD.name].verdict == "holds"
    unsupported = lambda engine, case: Answer("unsupported", "none")  # noqa: E731, ARG005 - as above
    assert check_replays(ENGINE, [METHOD], unsupported, [])[METHOD.name].message == "unsupported: none"


@pytest.mark.nightly
def test_a_reversible_map_must_reverse() -> None:
    """M1 breaks `reverse` if its map is declared reversible; Moser-Veselov obeys it."""
    for name, verdict in (("M1", "broken"), ("Moser-Veselov", "holds")):
        ask = stepping(MAPS[name].step)
        checked = check_laws(ENGINE, METHOD, ask, ask, reversible=True)
        assert {one.law.name: one.verdict for one in checked}[REVERSE] == verdict


@pytest.mark.parametrize(
    ("engine", "argument", "options"),
    [
        (Engine("cmd:python worker.py", "1", {}), "cmd:python worker.py::under-test", []),
        (
            Engine("my_module", "1", {}, Build(kind="handed over")),
            "my_module:under-test",
            ["--allow-code"],
        ),
    ],
)
def test_the_command_of_a_row_names_one_engine_and_permits_its_code(
    engine: Engine, argument: str, options: list[str]
) -> None:
    """A shell splits the command into words that select the method again."""
    fingerprint = fingerprint_row(engine, METHOD, Fingerprint(NOT_MEASURED))["reproduce"]
    assert shlex.split(fingerprint) == ["bodycheck", "fingerprint", argument, *options]
    (law,) = law_rows(engine, METHOD, [Checked(LAWS[0], "holds")])
    assert shlex.split(law["reproduce"]) == ["bodycheck", "laws", argument, *options]


@pytest.mark.slow
def test_laws_are_checked_without_probes(monkeypatch: pytest.MonkeyPatch) -> None:
    """`bodycheck laws` runs no probe, and checks every law."""
    monkeypatch.delattr(examination, "probe_rows")
    every = (*LAWS, *(law for law, _ in TREE_LAWS))
    assert {row["law"] for row in laws("reference:m1", timeout_s=60.0)} == {law.name for law in every}
    assert tuple(law.name for law in every) == LAW_NAMES


def test_the_document_of_laws_is_headed_by_whether_one_is_broken() -> None:
    """The first sentence is the heading, and its colour is that of the verdict."""
    row = {"engine": "e", "method": "m", "law": "momentum"}
    for verdict, tint in (("holds", "good"), ("broken", "bad")):
        head = laws_document([{**row, "verdict": verdict}]).parts[0]
        assert isinstance(head, Sentence)
        assert (head.tint, head.strong) == (tint, True)


def test_each_row_has_the_map_and_the_replay_of_its_method() -> None:
    """A method that was not examined has neither; the verdict of another law counts for nothing."""
    rows = [{"engine": "toy", "method": method, "quantity": "q"} for method in ("a", "b", "c")]
    maps = [{"engine": "toy", "method": "a", "fingerprint": "M1"}]
    laws = [
        {"engine": "toy", "method": "a", "law": REPLAY, "verdict": "holds"},
        {"engine": "toy", "method": "b", "law": REPLAY, "verdict": "property"},
        {"engine": "toy", "method": "a", "law": REVERSE, "verdict": "property"},
    ]
    found = [(row["fingerprint"], row["replay"]) for row in identified(rows, maps, laws)]
    assert found == [("M1", SAME_BITS), (None, OTHER_BITS), (None, None)]


MAP = '    explicit("late stage", 2, ["3/4"], "1/3 2/3", "a test"),\n'
"""The map that is added to a copy of the package, in one place."""
LATE_STAGE = """
from dataclasses import replace
import numpy as np

def step(state, dt):
    inertia = state.body.inertia

    def rate(y):
        (w, *v), omega = y[:4], y[4:]
        turn = [-np.dot(v, omega), *(w * omega + np.cross(v, omega))]
        torque = -np.cross(omega, inertia @ omega)
        return np.array([*np.multiply(0.5, turn), *np.linalg.solve(inertia, torque)])

    y = np.array([*state.quaternion, *state.omega_body])
    first = rate(y)
    y = y + dt / 3.0 * (first + 2.0 * rate(y + 0.75 * dt * first))
    return replace(state, quaternion=y[:4], omega_body=y[4:])
"""
"""The same map as somebody's integrator, written without the library."""


@pytest.mark.slow
def test_a_new_map_is_known_wherever_maps_are(tmp_path: Path) -> None:
    """A line in tableaus.py names it in fingerprints, in explanations and in judgements of recordings."""
    file, first = "bodycheck/reference_impl/one_step_maps/tableaus.py", '    explicit("Heun 2"'
    copy_with(tmp_path, file, first, MAP)
    (tmp_path / "mine.py").write_text(LATE_STAGE)
    (tmp_path / "mine.toml").write_text(tumbling())

    def printed(*words: str) -> str:
        return " ".join(printed_by(tmp_path, *words).split())

    name = "late stage, additive quaternion"
    assert f"known map {name}" in printed("fingerprint", "mine:step", "--allow-code")
    own = ("--engine", "mine:step", "--allow-code")
    printed("run", "mine.toml", *own, "--dt", "0.1", "--no-speed", "--quiet", "--out", "run")
    explained = printed("explain", "run", "--case", "mine,mine:step", "--allow-code")
    (motion,) = (tmp_path / "run/trajectories/mine").glob("mine_step*.npz")
    judged = printed("judge", str(motion), "--scenario", "mine.toml")
    for answer in (explained, judged):
        assert f"the motion is that of {name}" in answer, answer


def test_the_documentation_counts_the_known_maps() -> None:
    """The number of known maps in the documentation is theirs."""
    text = (ROOT / "docs/fingerprints.md").read_text()
    assert f"{len(MAPS)} known one-step maps" in text


def test_the_conclusion_about_known_maps_stands_first() -> None:
    """Before the table: of one method its map, of several which have none."""
    rows = [
        {"engine": "mine", "method": name, "fingerprint": found}
        for name, found in (("a", "M1"), ("b", NO_KNOWN_MAP))
    ]
    first = [fingerprint_document(some).parts[0] for some in (rows[:1], rows[1:], rows)]
    assert [(one.text, one.tint) for one in first if isinstance(one, Sentence)] == [
        ("mine:a steps by the known map semi-implicit Euler (M1)", "good"),
        (f"mine:b: {NO_KNOWN_MAP}", "open"),
        ("1 of 2 methods with a known map; without: mine:b", "open"),
    ]
