"""The kernels on tuples compared with numpy on arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators import right_hand_sides
from bodycheck.reference_impl.integrators.euler_svd import nearest_rotation
from bodycheck.reference_impl.kernels import small_vectors
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product, quaternion_to_matrix
from bodycheck.reference_impl.scene import RigidBody
from tests.helpers.kernel_programs import printed_json

EPS = float(np.finfo(np.float64).eps)

Case = tuple[Callable[..., Any], tuple[tuple[int, ...], ...], Callable[..., Array]]

CASES: dict[str, Case] = {
    "add": (small_vectors.add, ((3,), (3,)), lambda a, b: a + b),
    "cross": (small_vectors.cross, ((3,), (3,)), np.cross),
    "times": (small_vectors.times, ((3, 3), (3,)), lambda m, v: m @ v),
    "transposed_times": (small_vectors.transposed_times, ((3, 3), (3,)), lambda m, v: m.T @ v),
    "product": (small_vectors.product, ((3, 3), (3, 3)), lambda a, b: (a @ b).ravel()),
    "quaternion_times": (small_vectors.quaternion_times, ((4,), (4,)), quaternion_product),
    "matrix_of": (small_vectors.matrix_of, ((4,),), lambda q: quaternion_to_matrix(q).ravel()),
    "quaternion_exp": (small_vectors.quaternion_exp, ((3,),), exp_quaternion),
    "gyroscopic": (right_hand_sides.gyroscopic, ((3, 3), (3,)), lambda i, w: np.cross(w, i @ w)),
}


def packed(value: Array) -> tuple[float, ...]:
    """Return an array as the tuple that a kernel takes."""
    return tuple(float(x) for x in value.ravel())


@pytest.mark.parametrize("name", CASES)
def test_kernel_equals_numpy(name: str) -> None:
    """On random input a kernel gives numpy's result to the round-off of its terms."""
    kernel, shapes, expected = CASES[name]
    rng = np.random.default_rng(sorted(CASES).index(name))
    for _ in range(100):
        arguments = [rng.normal(size=shape) for shape in shapes]
        result = np.array(kernel(*(packed(argument) for argument in arguments)))
        # the largest term is below the product of the norms, squared because some kernels are quadratic
        scale = 1.0 + float(np.prod([1.0 + np.linalg.norm(argument) for argument in arguments]) ** 2)
        assert np.max(np.abs(result - expected(*arguments))) <= 4 * EPS * scale


def test_scaled_add() -> None:
    """a + s b."""
    rng = np.random.default_rng(1)
    for _ in range(100):
        a, b, s = rng.normal(size=3), rng.normal(size=3), float(rng.normal())
        assert np.allclose(
            small_vectors.scaled_add(packed(a), s, packed(b)), a + s * b, rtol=0.0, atol=16 * EPS
        )


def test_solve_has_the_error_of_the_condition_number() -> None:
    """Cramer's rule solves m x = b to eps times the condition number, also if m is not symmetric."""
    rng = np.random.default_rng(2)
    for _ in range(500):
        m, b = rng.normal(size=(3, 3)), rng.normal(size=3)
        expected = np.linalg.solve(m, b)
        allowed = 16 * EPS * float(np.linalg.cond(m)) ** 2 * float(np.linalg.norm(expected))
        assert np.max(np.abs(np.array(small_vectors.solve(packed(m), packed(b))) - expected)) <= allowed


@pytest.mark.parametrize("norm", [1e-100, 1e-8, 0.5, 3.0, 1e100])
def test_matrix_of_takes_any_norm(norm: float) -> None:
    """R(c q) = R(q) is orthogonal to round-off for any c."""
    rng = np.random.default_rng(3)
    for _ in range(100):
        q = rng.normal(size=4)
        matrix = np.array(small_vectors.matrix_of(packed(norm * q))).reshape(3, 3)
        assert np.max(np.abs(matrix - quaternion_to_matrix(q))) <= 16 * EPS
        assert np.max(np.abs(matrix.T @ matrix - np.eye(3))) <= 8 * EPS


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-162, 1e-154, 1e-20, 1e-8, 1e-4, 1.0, 3.0, 10.0])
def test_quaternion_exp_at_any_angle(angle: float) -> None:
    """(cos(a/2), sin(a/2) u) is accurate relative to the angle, even if its square underflows."""
    for axis in (*np.eye(3), *np.random.default_rng(4).normal(size=(10, 3))):
        v = angle * axis / np.linalg.norm(axis)
        w, *vector = small_vectors.quaternion_exp(packed(v))
        with mpmath.workdps(50):
            half = mpmath.sqrt(mpmath.fsum(mpmath.mpf(float(x)) ** 2 for x in v)) / 2
            factor = mpmath.sin(half) / half / 2 if half else mpmath.mpf("0.5")
            assert abs(float(w - mpmath.cos(half))) <= EPS * (2 + angle)
            for x, y in zip(vector, v, strict=True):
                assert abs(float(x - factor * mpmath.mpf(float(y)))) <= EPS * (4 + angle) * min(angle, 1.0)


def test_packed_body_holds_inertia_and_its_inverse() -> None:
    """(19,): mass, I row by row, I^-1 row by row."""
    tensor = np.array([[2.0, 0.1, -0.2], [0.1, 2.5, 0.3], [-0.2, 0.3, 3.0]])
    body = right_hand_sides.packed_body(RigidBody(1.7, tensor))
    assert body.shape == (19,)
    assert body[0] == 1.7
    assert np.array_equal(body[1:10].reshape(3, 3), tensor)
    assert np.max(np.abs(body[10:].reshape(3, 3) @ tensor - np.eye(3))) <= 8 * EPS


SHORT_MOTIONS = """
import json
import numpy as np
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.scene import RigidBody

tensor = np.array([[2.0, 0.1, -0.2], [0.1, 2.5, 0.3], [-0.2, 0.3, 3.0]])
body = packed_body(RigidBody(1.7, tensor))
load = np.linspace(-0.5, 0.7, 21)
q = np.array([0.5, -0.5, 0.1, 0.7])
q /= np.linalg.norm(q)
w, x, y, z = q
rotation = np.array([[1-2*(y*y+z*z), 2*(x*y-w*z), 2*(x*z+w*y)],
                     [2*(x*y+w*z), 1-2*(x*x+z*z), 2*(y*z-w*x)],
                     [2*(x*z-w*y), 2*(y*z+w*x), 1-2*(x*x+y*y)]])
omega = np.array([0.4, 1.5, -0.7])
found = {}
for name, integrator in INTEGRATORS.items():
    attitude = q if integrator.attitude == "quaternion" else rotation.ravel()
    spin = {"omega_body": omega, "omega_world": rotation @ omega,
            "angular_momentum": rotation @ tensor @ omega}[integrator.spin]
    state = np.concatenate([[1.0, -2.0, 0.5], [0.3, 0.2, -0.1], spin, attitude])
    integrator.advance(state, body, load, 0.01, 50)
    found[name] = state.tolist()
print(json.dumps(found))
"""


@pytest.mark.nightly
def test_compiled_kernels_equal_their_python_source() -> None:
    """Every integrator gives the same numbers compiled and interpreted."""
    compiled, interpreted = (printed_json(SHORT_MOTIONS, interpreted=plain) for plain in (False, True))
    assert compiled.keys() == interpreted.keys()
    for name, values in compiled.items():
        # 50 steps of about 100 fused or separate operations on numbers of size 3
        assert np.max(np.abs(np.array(values) - interpreted[name])) <= 1e-13, name


def test_jacobi_svd_gives_the_nearest_rotation() -> None:
    """U V^T by one-sided Jacobi rotations equals that of LAPACK's SVD, close to SO(3) and far from it."""
    rng = np.random.default_rng(11)
    for spread in (0.0, 1e-9, 1e-3, 1.0, 1e3):
        for _ in range(50):
            matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0] + spread * rng.normal(size=(3, 3))
            matrix *= np.sign(np.linalg.det(matrix))
            u, singular, vt = np.linalg.svd(matrix)
            found = np.reshape(nearest_rotation(tuple(matrix.ravel().tolist())), (3, 3))
            scale = singular[0] / (singular[1] + singular[2])  # the polar factor's own condition
            assert np.max(np.abs(found - u @ vt)) <= 50 * 2.3e-16 * max(scale, 1.0)
            assert np.max(np.abs(found.T @ found - np.eye(3))) <= 4e-15
