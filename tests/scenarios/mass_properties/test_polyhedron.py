"""Integrals over closed meshes against rational arithmetic, trimesh, and the laws of mass properties."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bodycheck.reference_impl.kernels.jit import interpreted
from bodycheck.reference_impl.rotations import exp_matrix
from bodycheck.scenarios.mass_properties.mesh_check import Mesh, checked_mesh
from bodycheck.scenarios.mass_properties.polyhedron import polyhedron, volume_area_reach
from bodycheck.scenarios.mass_properties.solid import MassProperties, primitive

TILT = exp_matrix(np.array([0.3, 0.5, 0.7]))
FAR = np.array([1000.0, -1000.0, 1000.0])


def test_the_unit_cubes_corner_is_exact(meshes: Any) -> None:
    """The unit tetrahedron at the origin has V = 1/6, its centre at 1/4, I_xx = 1/80 and I_xy = 1/480."""
    solid = polyhedron(*meshes.tetrahedron())
    assert solid.mass == pytest.approx(1 / 6, rel=1e-15, abs=0.0)
    assert solid.centre == pytest.approx([0.25] * 3, rel=1e-15, abs=0.0)
    expected = np.full((3, 3), 1 / 480) + np.diag([1 / 80 - 1 / 480] * 3)
    assert solid.inertia == pytest.approx(expected, rel=1e-14, abs=0.0)


@pytest.mark.parametrize("offset", [0.0, 1.0], ids=["near", "1000 m off"])
@pytest.mark.parametrize("shape", ["tetrahedron", "box", "ellipsoid", "torus", "slivers", "box in box"])
def test_meshes_match_rational_numbers(
    shape: str, offset: float, meshes: Any, joined: Any, exact_errors: Any
) -> None:
    """Mass, centre and inertia are within 1e-15 relative, wherever the mesh lies."""
    mesh = {
        "tetrahedron": meshes.tetrahedron,
        "box": lambda: meshes.box((-1.0, 0.0, 0.3), (2.0, 0.1, 0.7)),
        "ellipsoid": lambda: (meshes.sphere(3)[0] * [1.0, 0.7, 0.4], meshes.sphere(3)[1]),
        "torus": lambda: meshes.torus(3.0, 1.0, 24, 16),
        "slivers": lambda: meshes.prism(500, 1.0, 5.0),
        "box in box": lambda: joined(
            meshes.box(), (meshes.box([0.2] * 3, [0.5] * 3)[0], meshes.box()[1][:, ::-1])
        ),
    }[shape]()
    vertices = mesh[0] @ TILT.T + offset * FAR
    errors = exact_errors(vertices, mesh[1], polyhedron(vertices, mesh[1]))
    assert max(errors) < 1e-15


@pytest.mark.parametrize("shape", ["box", "ellipsoid", "slivers", "box in box"])
def test_interpreted_meshes_have_the_same_bits(shape: str, meshes: Any, joined: Any) -> None:
    """Compiled and interpreted kernels accept, merge, orient and integrate a mesh identically."""
    vertices, triangles = {
        "box": meshes.box,
        "ellipsoid": lambda: (meshes.sphere(1)[0] * [1.0, 0.7, 0.4], meshes.sphere(1)[1]),
        "slivers": lambda: meshes.prism(60, 1.0, 5.0),
        "box in box": lambda: joined(
            meshes.box(), (meshes.box([0.2] * 3, [0.5] * 3)[0], meshes.box()[1][:, ::-1])
        ),
    }[shape]()

    def checked() -> tuple[Mesh, MassProperties]:
        mesh = checked_mesh(vertices @ TILT.T + 0.1 * FAR, triangles)
        return mesh, polyhedron(mesh.vertices, mesh.triangles)

    with interpreted():
        one, solid = checked()
    other, compiled = checked()
    assert np.array_equal(one.vertices, other.vertices)
    assert np.array_equal(one.triangles, other.triangles)
    assert solid.mass == compiled.mass
    assert np.array_equal(solid.centre, compiled.centre)
    assert np.array_equal(solid.inertia, compiled.inertia)


def test_corners_far_from_the_mass_lose_no_digits(meshes: Any, joined: Any, exact_errors: Any) -> None:
    """A body is integrated about its own centroid, even if most corners lie elsewhere."""
    ball, triangles = meshes.sphere(2)
    vertices, triangles = joined((ball, triangles), meshes.prism(200, 0.5, 0.5))
    vertices[len(ball) :, 0] += 20.0
    assert max(exact_errors(vertices, triangles, polyhedron(vertices, triangles))) < 1e-15


def test_needle_keeps_its_smallest_moment(meshes: Any, exact_integrals: Any) -> None:
    """The moment about the axis of a prism, 1e-12 of the others, has a relative error below 1e-14."""
    vertices, triangles = meshes.prism(8, 1e-6, 1.0)
    expected = float(exact_integrals(vertices, triangles).inertia[2][2])
    assert polyhedron(vertices, triangles).inertia[2, 2] == pytest.approx(expected, rel=1e-14, abs=0.0)


@pytest.mark.parametrize(
    ("shape", "size"), [("ellipsoid", [1.0, 0.7, 0.4]), ("torus", [3.0, 1.0]), ("cylinder", [0.8, 2.0])]
)
def test_finer_meshes_converge_to_the_closed_form(shape: str, size: list[float], meshes: Any) -> None:
    """Each refinement by two reduces the difference to the closed form by a factor of four."""
    makers = {
        "ellipsoid": lambda n: (meshes.sphere(n)[0] * size, meshes.sphere(n)[1]),
        "torus": lambda n: meshes.torus(*size, 8 << n, 6 << n),
        "cylinder": lambda n: meshes.prism(16 << n, *size),
    }
    form = primitive(shape, size)
    solids = [polyhedron(*makers[shape](n)) for n in (2, 3, 4)]
    for error in (
        [form.mass - solid.mass for solid in solids],
        [form.inertia[0, 0] - solid.inertia[0, 0] for solid in solids],
        [form.inertia[2, 2] - solid.inertia[2, 2] for solid in solids],
    ):
        assert error[0] / error[1] == pytest.approx(4.0, rel=0.1)
        assert error[1] / error[2] == pytest.approx(4.0, rel=0.03)


def test_trimesh_agrees_near_the_origin(meshes: Any) -> None:
    """trimesh gives the same numbers to its own precision."""
    trimesh = pytest.importorskip("trimesh.triangles")
    vertices, triangles = meshes.torus(3.0, 1.0, 24, 16)
    vertices = vertices @ TILT.T
    other, solid = trimesh.mass_properties(vertices[triangles]), polyhedron(vertices, triangles)
    assert solid.mass == pytest.approx(other["mass"], rel=1e-14, abs=0.0)
    assert solid.centre == pytest.approx(other["center_mass"], abs=1e-14)
    assert solid.inertia == pytest.approx(other["inertia"], rel=1e-13, abs=1e-12)


def test_volume_area_and_reach_of_a_box(meshes: Any) -> None:
    """The properties are those of the box from (0, 0, 0) to (1, 2, 3)."""
    vertices, triangles = meshes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    assert volume_area_reach(vertices, triangles) == pytest.approx(
        (6.0, 22.0, np.sqrt(14.0)), rel=1e-15, abs=0.0
    )


vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
lengths = st.tuples(*[st.floats(0.1, 10.0)] * 3).map(np.array)


@st.composite
def convex_bodies(draw: st.DrawFn) -> Any:
    """Draw an octahedron with its six corners anywhere along the half-axes, tilted and shifted."""
    reach = np.array(draw(st.tuples(*[st.floats(0.1, 3.0)] * 6)))
    vertices = np.vstack([np.eye(3), -np.eye(3)]) * reach[:, None]
    triangles = np.array(
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    )
    return vertices @ exp_matrix(draw(vectors)).T + draw(vectors), triangles


@given(convex_bodies(), vectors)
@settings(max_examples=50, deadline=None, derandomize=True)
def test_translation_moves_the_centre_only(body: Any, displacement: Any) -> None:
    """Moving a mesh by d moves its centre by d and leaves mass and inertia unchanged."""
    vertices, triangles = body
    solid, moved = polyhedron(vertices, triangles), polyhedron(vertices + displacement, triangles)
    expected = solid.translated(displacement)
    assert moved.mass == pytest.approx(solid.mass, rel=1e-13, abs=0.0)
    assert moved.centre == pytest.approx(expected.centre, abs=1e-14)
    assert moved.inertia == pytest.approx(expected.inertia, abs=1e-13 * np.trace(solid.inertia))


@given(convex_bodies(), vectors)
@settings(max_examples=50, deadline=None, derandomize=True)
def test_rotation_rotates_centre_and_inertia(body: Any, vector: Any) -> None:
    """A mesh rotated by R has the centre R c and the inertia R I R^T."""
    vertices, triangles = body
    rotation = exp_matrix(vector)
    solid, turned = polyhedron(vertices, triangles), polyhedron(vertices @ rotation.T, triangles)
    expected = solid.rotated(rotation)
    assert turned.mass == pytest.approx(solid.mass, rel=1e-13, abs=0.0)
    assert turned.centre == pytest.approx(expected.centre, abs=1e-14)
    assert turned.inertia == pytest.approx(expected.inertia, abs=1e-13 * np.trace(solid.inertia))


@given(convex_bodies(), st.integers(-60, 60))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_scaling_by_a_power_of_two_is_exact(body: Any, power: int) -> None:
    """A mesh scaled by s = 2^k has s^3 the mass, s the centre and s^5 the inertia, to the last bit."""
    vertices, triangles = body
    s = 2.0**power
    solid, scaled = polyhedron(vertices, triangles), polyhedron(s * vertices, triangles)
    assert scaled.mass == s**3 * solid.mass
    assert np.array_equal(scaled.centre, s * solid.centre)
    assert np.array_equal(scaled.inertia, s**5 * solid.inertia)


@given(convex_bodies(), vectors)
@settings(max_examples=50, deadline=None, derandomize=True)
def test_two_halves_add_up_by_the_parallel_axis_theorem(body: Any, point: Any) -> None:
    """The parts on both sides of a cut together have the mass, first moment and inertia of the whole."""
    vertices, triangles = body
    # the corners 0, 1, 3, 4 are the octahedron's equator; 2 and 5 are its poles
    upper = np.vstack([triangles[:4], [[0, 4, 1], [1, 4, 3]]])
    lower = np.vstack([triangles[4:], [[0, 1, 4], [1, 3, 4]]])
    whole, above, below = (polyhedron(vertices, part) for part in (triangles, upper, lower))
    assert above.mass + below.mass == pytest.approx(whole.mass, rel=1e-13, abs=0.0)
    first = above.mass * above.centre + below.mass * below.centre
    assert first == pytest.approx(whole.mass * whole.centre, abs=1e-13 * whole.mass * 10.0)
    together = above.inertia_about(point) + below.inertia_about(point)
    about = whole.inertia_about(point)
    assert together == pytest.approx(about, abs=1e-13 * np.trace(about))


@given(convex_bodies())
@settings(max_examples=50, deadline=None, derandomize=True)
def test_moments_obey_the_triangle_inequality(body: Any) -> None:
    """All principal moments are positive, and none is larger than the sum of the other two."""
    moments, _ = polyhedron(*body).principal()
    assert moments[0] > 0.0
    assert moments[0] + moments[1] >= moments[2]
