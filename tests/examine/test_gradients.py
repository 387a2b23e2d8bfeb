"""`bodycheck gradients`: exact derivatives, and those of a map M1 with planted mistakes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mpmath
import numpy as np
import pytest

from bodycheck.adapters.contract import Method, Simulation
from bodycheck.adapters.gradients import Gradients
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import registered
from bodycheck.examine.gradients.engine_gradients import CaseGradients, method_gradients
from bodycheck.examine.gradients.sensitivity import TERMS, sensitivity
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_matrix, hat, vee
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.runs.gradients_run import SCENES, STEP_S, gradients, nudged
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.integer_taylor_series import exact_states


@dataclass(frozen=True)
class Differentiated:
    """The reference's M1, and its derivative by hand.

    missing: a term of it that is left out. factor: of the derivative by moments of inertia.
    """

    missing: str = ""
    factor: float = 1.0
    name: str = "differentiated"
    version: str = "1"

    @property
    def methods(self) -> Mapping[str, Method]:
        """M1 alone."""
        return {"m1": Reference().methods["m1"]}

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract
        """Nothing is."""
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build the reference's M1."""
        return Reference().build(scene, method, dt_s)

    def gradients(self, scene: Scene, method: str, dt_s: float) -> Gradients:  # noqa: ARG002 - the contract
        """Return the derivative of w += h a, R = R exp(h [w]x), step by step."""
        keep = {term: float(term != self.missing) for term in TERMS}
        moments, plan = np.diag(scene.body.inertia)[:, None], plan_steps(scene, dt_s)
        torque_world = next(plan.legs()).wrench.torque_world
        rotation, w = scene.initial.rotation, scene.initial.omega_body.copy()[:, None]
        theta, d_w = np.zeros((3, 6)), np.hstack([np.zeros((3, 3)), np.eye(3)])
        d_moments = np.hstack([np.eye(3), np.zeros((3, 3))])
        h = plan.dt_s
        for _ in range(plan.steps):
            torque = (rotation.T @ torque_world)[:, None]
            a = (torque - cross(w, moments * w)) / moments
            terms = (
                -cross(d_w, moments * w),
                -cross(w, moments * d_w),
                -cross(w, d_moments * w),
                -d_moments * a,
                cross(torque, theta),
            )
            d_w = d_w + h * sum(keep[name] * term for name, term in zip(TERMS, terms, strict=False)) / moments
            w = w + h * a
            step = h * w[:, 0]
            turned = exp_matrix(step)
            theta = (turned.T if keep["omega x d theta"] else np.eye(3)) @ theta
            theta = theta + keep["d omega in d theta/dt"] * h * (right_jacobian(step) @ d_w)
            rotation = rotation @ turned
        by_moments = np.array([self.factor] * 3 + [1.0] * 3)
        return Gradients(theta * by_moments, d_w * by_moments)


def cross(a: Array, b: Array) -> Array:
    """Return a x b of columns."""
    return np.cross(a, b, axis=0)


def right_jacobian(v: Array) -> Array:
    """exp([v + dv]x) = exp([v]x) exp([J dv]x)."""
    angle, matrix = float(np.linalg.norm(v)), hat(v)
    return (
        np.eye(3)
        - (1.0 - np.cos(angle)) / angle**2 * matrix
        + (angle - np.sin(angle)) / angle**3 * matrix @ matrix
    )


def exact_end(scene: Scene) -> tuple[Array, Array]:
    """Return R (3, 3) and omega (3,) in body axes at the end, as numbers of 50 digits."""
    values = np.array(exact_states(scene, [scene.duration_s])[0].values())
    rotation, momentum = values[:9].reshape(3, 3), values[9:12]
    moments = np.array([mpmath.mpf(float(value)) for value in np.diag(scene.body.inertia)])
    return rotation, rotation.T @ momentum / moments


@pytest.mark.parametrize("name", ["free sphere", "torque in world axes"])
def test_sensitivity_agrees_with_differences_of_fifty_digit_motions(name: str) -> None:
    """The exact derivative is that of motions in 50 digits, to 1e-10."""
    scene, h = SCENES[name], 2.0**-20
    with mpmath.workdps(50):
        back = exact_end(scene)[0].T
        columns = []
        for parameter in range(6):
            (turned, omega), (turned_back, omega_back) = (
                exact_end(nudged(scene, parameter, k * h)) for k in (1, -1)
            )
            slope = back @ (turned - turned_back) / (2 * mpmath.mpf(h))
            columns.append([*vee(slope.astype(float)), *((omega - omega_back) / (2 * mpmath.mpf(h)))])
    expected = np.array(columns, dtype=float).T
    assert np.max(np.abs(sensitivity(scene) - expected)) < 1e-10


@pytest.mark.slow
def test_a_healthy_derivative_is_right() -> None:
    """The derivative of M1 by hand is that of its motion, and the distance to the exact one halves."""
    with registered(Differentiated()):
        (found,) = gradients(["differentiated"], 60.0)
    (method,) = found.methods
    assert not found.wrong
    for block in method.blocks:
        assert block.own < 1e-8
        assert block.coarse / block.fine == pytest.approx(2.0, rel=0.05)


@pytest.fixture(scope="module")
def healthy() -> dict[str, Array]:
    """The derivatives of M1."""
    return {name: Differentiated().gradients(scene, "m1", STEP_S).matrix for name, scene in SCENES.items()}


def named(engine: Differentiated, healthy: dict[str, Array]) -> str:
    """Return the cause of the derivatives of an engine."""
    cases = []
    for name, scene in SCENES.items():
        found = engine.gradients(scene, "m1", STEP_S).matrix
        cases.append(CaseGradients(name, scene, found, found, healthy[name]))
    return method_gradients("m1", "float64", cases).cause


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("term", TERMS)
def test_a_missing_term_is_named(term: str, healthy: dict[str, Array]) -> None:
    """Each term that is left out of the derivative is named."""
    assert named(Differentiated(missing=term), healthy) == f"{term} is missing"


@pytest.mark.parametrize(("factor", "says"), [(0.0, "is 0"), (-1.0, "by -1"), (2.0, "by 2")])
def test_a_wrong_factor_is_named(factor: float, says: str, healthy: dict[str, Array]) -> None:
    """A derivative by inertia that is 0, reversed or doubled is named."""
    cause = named(Differentiated(factor=factor), healthy)
    assert cause.startswith("the derivative by inertia")
    assert says in cause


@pytest.mark.slow
def test_a_wrong_derivative_fails_the_command(tmp_path: Path) -> None:
    """The command names the missing term, with status 1."""
    with registered(Differentiated(missing=TERMS[2])):
        result = run_bodycheck(tmp_path, "gradients", "differentiated")
    assert result.returncode == 1
    assert f"differentiated:m1: {TERMS[2]} is missing" in result.stdout


def test_an_engine_without_derivatives_is_unsupported(tmp_path: Path) -> None:
    """The command says that an engine computes none, with status 0."""
    result = run_bodycheck(tmp_path, "gradients", "reference:m1", "--json")
    assert result.returncode == 0
    (found,) = json.loads(result.stdout)
    (method,) = found["methods"]
    assert method["outcome"] == "unsupported"
    assert not method["blocks"]


@pytest.mark.engines
@pytest.mark.parametrize("name", ["mjx:euler@float64", "mjx:euler", "newton:semi-implicit", "newton:xpbd"])
def test_differentiable_engines_are_right(name: str) -> None:
    """Derivatives by JAX and by Warp are right."""
    (found,) = gradients([name], 300.0)
    assert found.methods[0].blocks
    assert not found.wrong


@pytest.mark.engines
def test_the_overwritten_matrices_of_featherstone_are_found() -> None:
    """Newton's Featherstone overwrites its matrices at each step, so that its derivatives are wrong."""
    (found,) = gradients(["newton:featherstone"], 300.0)
    assert found.wrong
