"""Faults of meshes: each is refused with its place, or corrected with a note."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bodycheck.scenarios.mass_properties.containment import winding_number
from bodycheck.scenarios.mass_properties.mesh_check import checked_mesh
from bodycheck.scenarios.mass_properties.polyhedron import polyhedron
from bodycheck.scenarios.mass_properties.vertex_merge import merged
from tests.helpers.expected_messages import ExpectedMessage


def volume(mesh: Any) -> float:
    """Return the volume of a checked mesh."""
    return polyhedron(mesh.vertices, mesh.triangles).mass


def soup(vertices: Any, triangles: Any) -> tuple[Any, Any]:
    """Give each triangle its own corners, as an STL file does."""
    return vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


@pytest.mark.slow
def test_correct_mesh_is_unchanged(meshes: Any) -> None:
    """A correct mesh keeps its vertices and triangles in order, without a note."""
    vertices, triangles = meshes.sphere(2)
    mesh = checked_mesh(vertices, triangles)
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.triangles, triangles)
    assert mesh.notes == ()


def test_triangles_without_shared_vertices_are_merged(meshes: Any) -> None:
    """Triangles without shared vertices get the vertices of the mesh; 0.0 and -0.0 are equal."""
    vertices, triangles = meshes.sphere(2)
    corners, rows = soup(vertices, triangles)
    corners[::2] = np.where(corners[::2] == 0.0, -0.0, corners[::2])
    mesh = checked_mesh(corners, rows)
    assert len(mesh.vertices) == len(vertices)
    assert np.array_equal(mesh.vertices[mesh.triangles], vertices[triangles])
    assert mesh.notes == ()


@given(st.lists(st.tuples(*[st.sampled_from([-1.0, -0.0, 0.0, 5e-324, 1.0, 1e300])] * 3), max_size=40))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_merging_equals_that_of_a_dictionary(points: list[tuple[float, float, float]]) -> None:
    """Each row gets the number of the first row equal to it; numbers follow the order of appearance."""
    numbers: dict[tuple[float, float, float], int] = {}
    expected = [numbers.setdefault(point, len(numbers)) for point in points]
    distinct, number = merged(np.array(points, dtype=np.float64).reshape(-1, 3))
    assert number.tolist() == expected
    assert [tuple(row) for row in distinct] == list(numbers)


@pytest.mark.parametrize("flipped", [[3], [0, 1, 7], [0, 1, 2, 3, 4, 5]])
def test_flipped_triangles_are_reversed(flipped: list[int], meshes: Any) -> None:
    """A closed surface with some reversed triangles is corrected, and a note states their number."""
    vertices, triangles = meshes.box()
    triangles[flipped] = triangles[flipped, ::-1]
    mesh = checked_mesh(vertices, triangles)
    assert volume(mesh) == 1.0
    assert mesh.notes[0].startswith(
        f"{len(flipped)} of the triangles had the wrong orientation and were reversed, at ("
    )


def test_mostly_flipped_mesh_ends_facing_outward(meshes: Any) -> None:
    """If more than half of the triangles face inward, these are reversed and counted."""
    vertices, triangles = meshes.box()
    triangles[:11] = triangles[:11, ::-1]
    mesh = checked_mesh(vertices, triangles)
    assert volume(mesh) == 1.0
    assert mesh.notes[0].startswith("11 of the triangles")


def test_inside_out_mesh_is_reversed(meshes: Any) -> None:
    """A mesh whose triangles all face inward is reversed as a whole, with a note."""
    vertices, triangles = meshes.sphere(2)
    mesh = checked_mesh(vertices, triangles[:, ::-1])
    assert np.array_equal(mesh.triangles, triangles)
    assert mesh.notes == ("the mesh was inside-out; all its triangles were reversed",)


def test_collapsed_triangles_are_dropped(meshes: Any) -> None:
    """Triangles with two equal corners, by index or coordinates, are dropped and counted in a note."""
    vertices, triangles = meshes.box()
    corners, rows = soup(vertices, np.vstack([triangles, [[0, 0, 1], [2, 5, 2]]]))
    mesh = checked_mesh(corners, rows)
    assert volume(mesh) == 1.0
    assert mesh.notes == (
        "2 of the triangles had two equal corners and were removed, at (0, 0, 0); (0, 1, 0)",
    )


def test_cavity_is_kept(meshes: Any, joined: Any) -> None:
    """An inward surface within another one is a cavity, and a surface within that cavity is matter again."""
    big, middle, small = (meshes.box([a] * 3, [1 - a] * 3) for a in (0.0, 0.25, 0.375))
    mesh = checked_mesh(*joined(big, (middle[0], middle[1][:, ::-1]), small))
    assert volume(mesh) == 1.0 - 0.5**3 + 0.25**3
    assert mesh.notes == ("the mesh has 3 closed surfaces; none was found to cross another",)


def test_inside_out_shell_is_reversed_as_a_whole(meshes: Any, joined: Any) -> None:
    """An outer surface facing inward and its cavity facing outward are both reversed."""
    big, small = meshes.box(), meshes.box([0.25] * 3, [0.75] * 3)
    mesh = checked_mesh(*joined((big[0], big[1][:, ::-1]), small))
    assert volume(mesh) == 1.0 - 0.5**3
    assert mesh.notes[0] == "the mesh was inside-out; all its triangles were reversed"


def test_separate_parts_are_oriented_one_by_one(meshes: Any, joined: Any) -> None:
    """A surface that lies within no other is oriented outward independently of the others."""
    one, other = meshes.box(), meshes.box((2.0, 0.0, 0.0), (3.0, 1.0, 1.0))
    mesh = checked_mesh(*joined(one, (other[0], other[1][:, ::-1])))
    assert volume(mesh) == 2.0
    assert mesh.notes[0].startswith(
        "12 of the triangles had the wrong orientation and were reversed, at (3, 1, 1)"
    ) or (mesh.notes[0].startswith("12 of the triangles had the wrong orientation and were reversed, at (2"))


def test_touching_parts_stay_separate(meshes: Any, joined: Any) -> None:
    """Two boxes that share part of a face remain two boxes."""
    mesh = checked_mesh(*joined(meshes.box(), meshes.box((1.0, 0.25, 0.25), (2.0, 0.75, 0.75))))
    assert volume(mesh) == 1.25


def test_crossing_bars_are_refused(meshes: Any, joined: Any, expected_message: ExpectedMessage) -> None:
    """Two bars that cross are refused, although neither has a corner inside the other."""
    along, across = meshes.box((-5, -1, -1), (5, 1, 1)), meshes.box((-0.5, -6, -0.5), (0.5, 6, 0.5))
    with expected_message.raises(ValueError):
        checked_mesh(*joined(along, across))


@pytest.mark.parametrize("lift", [(0.0, 0.0, 1e-13), (1e-13, 1e-13, 1e-13)])
def test_coincident_surfaces_are_refused(
    lift: Any, meshes: Any, joined: Any, expected_message: ExpectedMessage
) -> None:
    """Two copies of a box that differ in the last digits are neither nested nor two boxes."""
    vertices, triangles = meshes.box()
    with expected_message.raises(ValueError):
        checked_mesh(*joined((vertices, triangles), (vertices + lift, triangles)))


def crossing_bars(meshes: Any, joined: Any) -> tuple[Any, Any]:
    """Return crossing bars of 40 and 12 m^3, neither of which has a corner in the other."""
    return joined(meshes.box((-5, -1, -1), (5, 1, 1)), meshes.box((-0.5, -6, -0.5), (0.5, 6, 0.5)))


def test_crossing_parts_count_twice_on_request(meshes: Any, joined: Any) -> None:
    """The volume of crossing bars is the sum of both, and a note states that the overlap counts twice."""
    mesh = checked_mesh(*crossing_bars(meshes, joined), "count-twice")
    assert volume(mesh) == 40.0 + 12.0
    assert mesh.notes == (
        "the mesh has 2 closed surfaces; 1 crossing pairs are among them: what they share counts as often as "
        "it is drawn",
    )


def test_matter_within_matter_counts_twice_on_request(meshes: Any, joined: Any) -> None:
    """An insert within a solid block adds its own volume without its cavity; a cavity stays a cavity."""
    boxes = [meshes.box([a] * 3, [1 - a] * 3) for a in (0.0, 0.25, 0.375)]
    inward = [(vertices, triangles[:, ::-1]) for vertices, triangles in boxes]
    insert = checked_mesh(*joined(boxes[0], boxes[1]), "count-twice")
    assert volume(insert) == 1.0 + 0.5**3
    assert "1 lie within matter" in insert.notes[0]
    assert (
        volume(checked_mesh(*joined(boxes[0], boxes[1], inward[2]), "count-twice")) == 1.0 + 0.5**3 - 0.25**3
    )
    assert (
        volume(checked_mesh(*joined(boxes[0], inward[1], boxes[2]), "count-twice")) == 1.0 - 0.5**3 + 0.25**3
    )


def test_ambiguous_part_is_refused_on_request_too(
    meshes: Any, joined: Any, expected_message: ExpectedMessage
) -> None:
    """A part that crosses another one and faces inward may be a cut, so it is refused."""
    box, other = meshes.box(), meshes.box([0.5] * 3, [1.5] * 3)
    with expected_message.raises(ValueError):
        checked_mesh(*joined(box, (other[0], other[1][:, ::-1])), "count-twice")


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
@pytest.mark.parametrize("slit", [1e-17, 1e-15, 1e-12, 5e-8])
def test_slits_of_round_off_are_closed(slit: float, scale: float, meshes: Any) -> None:
    """Triangles with their own corners, a round-off apart, give a closed mesh and a note."""
    vertices, triangles = meshes.sphere(2)
    corners, rows = soup(vertices, triangles)
    corners[:30] += slit * np.random.default_rng(0).uniform(-0.5, 0.5, (30, 3))
    mesh = checked_mesh(scale * corners, rows)
    assert mesh.notes[0].startswith("the mesh was open by round-off only: ")
    exact = volume(checked_mesh(scale * vertices, triangles))
    assert volume(mesh) == pytest.approx(exact, rel=max(1e-15, slit), abs=0.0)


@pytest.mark.parametrize(
    ("gap", "split"), [(1e-6, 1e-6), (1e-3, 1e-3), (1e-8, 1e-6), (1e-14, 3e-12)], ids=str
)
def test_real_gaps_stay_open(
    gap: float, split: float, meshes: Any, expected_message: ExpectedMessage
) -> None:
    """A gap of 1e-6 stays open, and so does a round-off gap if other corners are nearly as close."""
    vertices, triangles = meshes.box()
    middle = len(vertices)
    # the first triangle is split at a point of its edge, and its neighbour there is not
    start, end, tip = triangles[0]
    near = vertices[start] + split * (vertices[end] - vertices[start])
    vertices = np.vstack([vertices, near + gap * np.array([0.3, 0.5, 0.7])])
    triangles = np.vstack([triangles[1:], [[start, middle, tip], [middle, end, tip]]])
    with expected_message.raises(ValueError):
        checked_mesh(vertices, triangles)


def test_closed_mesh_is_not_searched_for_slits(meshes: Any) -> None:
    """A closed plate thinner than the tolerances keeps both of its faces."""
    mesh = checked_mesh(*meshes.box((0.0, 0.0, 0.0), (1.0, 1.0, 1e-12)))
    assert volume(mesh) == pytest.approx(1e-12, rel=1e-12, abs=0.0)
    assert mesh.notes == ()


@pytest.mark.nightly
def test_parts_that_share_an_edge_are_separated(meshes: Any, joined: Any) -> None:
    """Two boxes with a common edge of four triangles are two boxes, even if they are inside-out."""
    one, other = meshes.box(), meshes.box((1.0, 1.0, 0.0), (2.0, 2.0, 1.0))
    vertices, triangles = joined(one, other)
    mesh = checked_mesh(vertices, triangles)
    assert volume(mesh) == 2.0
    assert mesh.notes[0] == "at 1 edges parts touch; they were separated by which side is solid"
    assert mesh.notes[1].startswith("the mesh has 2 closed surfaces")
    assert volume(checked_mesh(vertices, triangles[:, ::-1])) == 2.0


def test_wall_shared_by_two_parts_is_dropped(meshes: Any, joined: Any) -> None:
    """Two boxes with a common face that is present twice form one box of twice the length."""
    vertices, triangles = joined(meshes.box(), meshes.box((1.0, 0.0, 0.0), (2.0, 1.0, 1.0)))
    wall = np.flatnonzero((vertices[triangles][:, :, 0] == 1.0).all(axis=1))
    assert volume(checked_mesh(vertices, triangles)) == 2.0  # triangulated along different diagonals
    mine = triangles[wall[:2]]
    triangles[wall[2:]] = np.array([np.flatnonzero((vertices == v).all(axis=1))[-1] for v in vertices])[mine][
        :, ::-1
    ]
    mesh = checked_mesh(vertices, triangles)
    assert volume(mesh) == 2.0
    assert mesh.notes[0].startswith("4 of the triangles lie back to back and were removed, at (1, ")


@pytest.mark.nightly
def test_cavity_that_touches_its_surface_stays_a_cavity(meshes: Any, joined: Any) -> None:
    """A cavity may touch the outer surface along an edge of four triangles."""
    hollow = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 4.0], [1.0, 2.0, 2.0], [2.0, 1.0, 2.0]])  # 2 m^3, inward
    mesh = checked_mesh(*joined(meshes.box((0, 0, 0), (4, 4, 4)), (hollow, meshes.tetrahedron()[1])))
    assert volume(mesh) == pytest.approx(64.0 - 2.0, rel=1e-15, abs=0.0)


@pytest.mark.parametrize("fault", ["drawn twice", "overlapping", "three"])
def test_edges_where_matter_does_not_alternate_are_refused(
    fault: str, meshes: Any, joined: Any, expected_message: ExpectedMessage
) -> None:
    """A box present twice, boxes that overlap from a common edge, and a fin are refused."""
    box = meshes.box((0.0, 0.0, 0.0), (2.0, 2.0, 1.0))
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    drawn = {
        "drawn twice": lambda: joined(box, box),
        "overlapping": lambda: joined(box, (corners, meshes.tetrahedron()[1])),
        "three": lambda: (np.vstack([box[0], [[9.0, 9.0, 9.0]]]), np.vstack([box[1], [[0, 1, 8]]])),
    }[fault]()
    with expected_message.raises(ValueError):
        checked_mesh(*drawn)


@pytest.mark.parametrize(("parts", "most"), [(1, 150), (2, 150)])
def test_check_takes_at_most_150_bytes_per_triangle(parts: int, most: int, meshes: Any, joined: Any) -> None:
    """Peak memory is at most 150 bytes per triangle, below 200 with the 50 bytes of an STL file."""
    sphere = meshes.sphere(5)
    mesh = joined(*(((1.0 - 0.5 * k) * sphere[0], sphere[1][:, :: 1 - 2 * k]) for k in range(parts)))
    checked_mesh(*mesh)  # compile the kernels
    tracemalloc.start()
    checked_mesh(*mesh)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak / len(mesh[1]) < most


def klein_bottle(meshes: Any) -> tuple[Any, Any]:
    """Return a closed surface with one side."""

    def point(u: float, v: float) -> Any:
        rho = 3.0 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
        return rho * np.cos(u), rho * np.sin(u), np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)

    vertices, triangles = meshes.grid_surface(8, 8, point)
    # the last row joins the first one in reverse order
    columns = np.arange(8)
    seam = np.isin(triangles, columns) & (triangles >= 56).any(axis=1, keepdims=True)
    return vertices, np.where(seam, -triangles % 8, triangles)


FAULTS = (
    "open",
    "shared",
    "one-sided",
    "flat",
    "collapsed",
    "matter twice",
    "mended cavity",
    "crossing",
    "nan",
    "infinite",
    "no such vertex",
    "negative",
    "no triangles",
    "huge",
    "vertices",
    "triangles",
)


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_refused_with_their_place(
    fault: str, meshes: Any, joined: Any, expected_message: ExpectedMessage
) -> None:
    """A mesh that bounds no solid, or more than one possible solid, is refused with the place."""
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
    with expected_message.raises(ValueError):
        checked_mesh(vertices, triangles)


def test_winding_number_separates_inside_from_outside(meshes: Any) -> None:
    """The winding number is 1 inside an outward torus, 0 in its hole and outside, and NaN on a face."""
    vertices, triangles = meshes.torus(3.0, 1.0, 12, 8)
    on_face = vertices[triangles[5]].mean(axis=0)
    points = [(3.0, 0.0, 0.0), (0.0, 0.0, 0.0), (9.0, 0.0, 0.0), tuple(on_face)]
    winding = [winding_number(point, vertices, triangles) for point in points]
    assert winding[:3] == pytest.approx([1.0, 0.0, 0.0], abs=1e-14)
    assert np.isnan(winding[3])
