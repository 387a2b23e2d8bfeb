"""Every fault of a mesh is refused by a message that says where, or put right by a note that says so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bodycheck.reference_impl.mass_properties.merging import merged
from bodycheck.reference_impl.mass_properties.mesh_check import checked_mesh
from bodycheck.reference_impl.mass_properties.nesting import winding_number
from bodycheck.reference_impl.mass_properties.polyhedron import polyhedron


def volume(mesh: Any) -> float:
    """Return the volume of a checked mesh."""
    return polyhedron(mesh.vertices, mesh.triangles).mass


def soup(vertices: Any, triangles: Any) -> tuple[Any, Any]:
    """Give each triangle corners of its own, as an STL file does."""
    return vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def test_a_good_mesh_passes_as_it_is(meshes: Any) -> None:
    """Vertices, triangles and their order stay; there is nothing to note."""
    vertices, triangles = meshes.sphere(2)
    mesh = checked_mesh(vertices, triangles)
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.triangles, triangles)
    assert mesh.notes == ()


def test_triangles_with_their_own_corners_are_joined(meshes: Any) -> None:
    """The vertices of a soup of triangles become those of the mesh, 0.0 and -0.0 the same."""
    vertices, triangles = meshes.sphere(2)
    corners, rows = soup(vertices, triangles)
    corners[::2] = np.where(corners[::2] == 0.0, -0.0, corners[::2])
    mesh = checked_mesh(corners, rows)
    assert len(mesh.vertices) == len(vertices)
    assert np.array_equal(mesh.vertices[mesh.triangles], vertices[triangles])
    assert mesh.notes == ()


@given(st.lists(st.tuples(*[st.sampled_from([-1.0, -0.0, 0.0, 5e-324, 1.0, 1e300])] * 3), max_size=40))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_merging_is_that_of_a_dictionary(points: list[tuple[float, float, float]]) -> None:
    """Each row gets the number of the first row equal to it, numbers running in order of appearance."""
    numbers: dict[tuple[float, float, float], int] = {}
    expected = [numbers.setdefault(point, len(numbers)) for point in points]
    distinct, number = merged(np.array(points, dtype=np.float64).reshape(-1, 3))
    assert number.tolist() == expected
    assert [tuple(row) for row in distinct] == list(numbers)


@pytest.mark.parametrize("flipped", [[3], [0, 1, 7], [0, 1, 2, 3, 4, 5]])
def test_flipped_triangles_are_turned(flipped: list[int], meshes: Any) -> None:
    """A closed surface with some triangles the wrong way has them turned, and a note counts them."""
    vertices, triangles = meshes.box()
    triangles[flipped] = triangles[flipped, ::-1]
    mesh = checked_mesh(vertices, triangles)
    assert volume(mesh) == 1.0
    assert mesh.notes[0].startswith(
        f"{len(flipped)} of the triangles faced the wrong way and were turned, at ("
    )


def test_a_mesh_mostly_flipped_ends_facing_outward(meshes: Any) -> None:
    """Where more than half of the triangles face inward, those are what is turned and noted."""
    vertices, triangles = meshes.box()
    triangles[:11] = triangles[:11, ::-1]
    mesh = checked_mesh(vertices, triangles)
    assert volume(mesh) == 1.0
    assert mesh.notes[0].startswith("11 of the triangles")


def test_an_inside_out_mesh_is_turned(meshes: Any) -> None:
    """A mesh all of whose triangles face inward is turned as a whole, and a note says so."""
    vertices, triangles = meshes.sphere(2)
    mesh = checked_mesh(vertices, triangles[:, ::-1])
    assert np.array_equal(mesh.triangles, triangles)
    assert mesh.notes == ("the mesh was inside-out; all its triangles were turned",)


def test_collapsed_triangles_are_left_out(meshes: Any) -> None:
    """Triangles with two equal corners, also equal by coordinates only, go, and a note counts them."""
    vertices, triangles = meshes.box()
    corners, rows = soup(vertices, np.vstack([triangles, [[0, 0, 1], [2, 5, 2]]]))
    mesh = checked_mesh(corners, rows)
    assert volume(mesh) == 1.0
    assert mesh.notes == (
        "2 of the triangles had two equal corners and were left out, at (0, 0, 0); (0, 1, 0)",
    )


def test_a_cavity_is_kept(meshes: Any, joined: Any) -> None:
    """A surface within another that faces inward is a cavity, and matter within that cavity is matter."""
    big, middle, small = (meshes.box([a] * 3, [1 - a] * 3) for a in (0.0, 0.25, 0.375))
    mesh = checked_mesh(*joined(big, (middle[0], middle[1][:, ::-1]), small))
    assert volume(mesh) == 1.0 - 0.5**3 + 0.25**3
    assert mesh.notes == ("the mesh has 3 closed surfaces; none was found to cross another",)


def test_an_inside_out_shell_is_turned_as_a_whole(meshes: Any, joined: Any) -> None:
    """Outer surface inward and cavity outward: both are turned."""
    big, small = meshes.box(), meshes.box([0.25] * 3, [0.75] * 3)
    mesh = checked_mesh(*joined((big[0], big[1][:, ::-1]), small))
    assert volume(mesh) == 1.0 - 0.5**3
    assert mesh.notes[0] == "the mesh was inside-out; all its triangles were turned"


def test_separate_parts_are_turned_one_by_one(meshes: Any, joined: Any) -> None:
    """A surface that lies within no other is turned outward by itself."""
    one, other = meshes.box(), meshes.box((2.0, 0.0, 0.0), (3.0, 1.0, 1.0))
    mesh = checked_mesh(*joined(one, (other[0], other[1][:, ::-1])))
    assert volume(mesh) == 2.0
    assert mesh.notes[0].startswith(
        "12 of the triangles faced the wrong way and were turned, at (3, 1, 1)"
    ) or (mesh.notes[0].startswith("12 of the triangles faced the wrong way and were turned, at (2"))


def test_parts_that_touch_stay_parts(meshes: Any, joined: Any) -> None:
    """Two boxes that share part of a face are two boxes."""
    mesh = checked_mesh(*joined(meshes.box(), meshes.box((1.0, 0.25, 0.25), (2.0, 0.75, 0.75))))
    assert volume(mesh) == 1.25


def test_bars_that_cross_are_refused(meshes: Any, joined: Any) -> None:
    """Two bars through each other, neither with a corner inside the other, are seen to cross."""
    along, across = meshes.box((-5, -1, -1), (5, 1, 1)), meshes.box((-0.5, -6, -0.5), (0.5, 6, 0.5))
    with pytest.raises(ValueError, match=r"its closed surfaces at .* and .* cross; what they share"):
        checked_mesh(*joined(along, across))


@pytest.mark.parametrize("lift", [(0.0, 0.0, 1e-13), (1e-13, 1e-13, 1e-13)])
def test_surfaces_upon_each_other_are_refused(lift: Any, meshes: Any, joined: Any) -> None:
    """A box drawn twice but for the last digits is neither inside nor outside itself, and not two boxes."""
    vertices, triangles = meshes.box()
    with pytest.raises(ValueError, match=r"its closed surfaces at .* and .* (lie upon each other|cross)"):
        checked_mesh(*joined((vertices, triangles), (vertices + lift, triangles)))


def klein_bottle(meshes: Any) -> tuple[Any, Any]:
    """Return a closed surface of one side."""

    def point(u: float, v: float) -> Any:
        rho = 3.0 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
        return rho * np.cos(u), rho * np.sin(u), np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)

    vertices, triangles = meshes.grid_surface(8, 8, point)
    # the last row joins the first one run through backwards
    columns = np.arange(8)
    seam = np.isin(triangles, columns) & (triangles >= 56).any(axis=1, keepdims=True)
    return vertices, np.where(seam, -triangles % 8, triangles)


FAULTS = {
    "open": "the mesh is open: 3 edges belong to one triangle only: from (0, 0, 0) to (0, 1, 1); from ",
    "shared": "the mesh is no surface: 3 edges are shared by more than two triangles: from (",
    "one-sided": "the mesh is not orientable: its surface has one side only; the two sides meet on ",
    "flat": "the mesh is degenerate: the closed surface at (0, 0, 0) encloses no volume",
    "collapsed": "the mesh is degenerate: each triangle has two equal corners",
    "matter twice": "the mesh is ambiguous: the closed surface at (0.25, 0.25, 0.25) lies within",
    "mended cavity": "the mesh is ambiguous: the closed surface at (0.25, 0.75, 0.75) lies within",
    "crossing": "the mesh is ambiguous: its closed surfaces at (0, 0, 0) and (0.5, 0.5, 0.5) cross;",
    "nan": "vertex 3 is not finite: [0.0, nan, 1.0]",
    "infinite": "vertex 3 is not finite: [0.0, inf, 1.0]",
    "no such vertex": "triangle 2 has the corners [0, 4, 8], but vertices are 0 to 7",
    "negative": "triangle 2 has the corners [0, 4, -1], but vertices are 0 to 7",
    "no triangles": "the mesh has no triangles",
    "huge": "the largest coordinate is 1e+60 m; it must be within 1e-50 to 1e+50 m",
    "vertices": "vertices must be (n, 3), not (12, 2)",
    "triangles": "triangles must be whole numbers (m, 3), not float64 (12, 3)",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_refused_by_name_and_place(fault: str, meshes: Any, joined: Any) -> None:
    """A mesh that bounds no solid, or more than one reading of it, is refused, saying what and where."""
    vertices, triangles = meshes.box()
    inner = meshes.box([0.25] * 3, [0.75] * 3)
    match fault:
        case "open":
            triangles = triangles[1:]
        case "shared":
            triangles = np.vstack([triangles, triangles[:1]])
        case "one-sided":
            vertices, triangles = klein_bottle(meshes)
        case "flat":
            vertices = vertices * [1.0, 1.0, 0.0] @ np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0.3], [0, 0, 1.0]])
            vertices[1::2] += [1e-17, 0.0, 1e-17]
        case "collapsed":
            triangles = triangles[:, [0, 0, 1]]
        case "matter twice":
            vertices, triangles = joined((vertices, triangles), inner)
        case "mended cavity":
            inner[1][1:] = inner[1][1:, ::-1]
            vertices, triangles = joined((vertices, triangles), inner)
        case "crossing":
            vertices, triangles = joined((vertices, triangles), meshes.box([0.5] * 3, [1.5] * 3))
        case "nan":
            vertices[3, 1] = np.nan
        case "infinite":
            vertices[3, 1] = np.inf
        case "no such vertex":
            triangles[2] = [0, 4, 8]
        case "negative":
            triangles[2] = [0, 4, -1]
        case "no triangles":
            triangles = triangles[:0]
        case "huge":
            vertices *= 1e60
        case "vertices":
            vertices = vertices.reshape(-1, 2)
        case "triangles":
            triangles = triangles * 1.0
    with pytest.raises(ValueError, match=r"mesh|vert|triangles|coordinate") as caught:
        checked_mesh(vertices, triangles)
    assert str(caught.value).startswith(FAULTS[fault])


def test_winding_numbers_tell_inside_from_outside(meshes: Any) -> None:
    """1 inside an outward torus, 0 in its hole and outside, NaN on a face."""
    vertices, triangles = meshes.torus(3.0, 1.0, 12, 8)
    on_face = vertices[triangles[5]].mean(axis=0)
    points = [(3.0, 0.0, 0.0), (0.0, 0.0, 0.0), (9.0, 0.0, 0.0), tuple(on_face)]
    winding = [winding_number(point, vertices, triangles) for point in points]
    assert winding[:3] == pytest.approx([1.0, 0.0, 0.0], abs=1e-14)
    assert np.isnan(winding[3])
