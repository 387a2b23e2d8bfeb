"""The surfaces that pages and films draw: closed, outward, of the volume of the body, and of limited size."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.comparison.environment_diff import redefined
from bodycheck.reports.render.body_surface import REACH, BodySurface, polygons_of, surface_of
from bodycheck.scenarios.body import ShapeBody
from bodycheck.scenarios.library import load_scenario
from bodycheck.scenarios.mesh_files.decimation import MAX_TRIANGLES, decimated, obj_text, read_obj_text
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.serialization import deserialized, serialized


def volume(vertices: Array, faces: tuple[tuple[int, ...], ...]) -> float:
    """Return the signed volume: sum of a . (b x c) / 6 over the fans of the faces."""
    fans = (vertices[[face[0], b, c]] for face in faces for b, c in pairwise(face[1:]))
    return float(sum(np.linalg.det(corners) for corners in fans) / 6.0)


def assert_closed(surface: BodySurface) -> None:
    """Each edge of a face is an edge of another one in the opposite direction."""
    edges = Counter(edge for face in surface.faces for edge in zip(face, (*face[1:], face[0]), strict=True))
    assert all(edges[end, start] == count for (start, end), count in edges.items())


@pytest.mark.parametrize(
    ("shape", "size", "farthest"),
    [
        ("box", (1.0, 2.0, 3.0), 0.5 * 14.0**0.5),
        ("sphere", (0.7,), 0.7),
        ("ellipsoid", (1.0, 2.0, 3.0), 3.0),
        ("cylinder", (1.0, 2.0), 2.0**0.5),
        ("capsule", (1.0, 2.0), 2.0),
        ("torus", (2.0, 0.5), 2.5),
    ],
)
def test_primitive_is_drawn_as_itself(shape: str, size: tuple[float, ...], farthest: float) -> None:
    """Its surface is closed, has its volume to the width of the polygons, and some faces are marked."""
    body = ShapeBody(shape=shape, size_m=size, density_kg_m3=1.0)
    surface = surface_of(body)
    assert_closed(surface)
    assert np.linalg.norm(surface.vertices, axis=1).max() == pytest.approx(REACH)
    scaled = volume(surface.vertices, surface.faces) * (farthest / REACH) ** 3
    assert 0.93 * body.mass_kg < scaled <= body.mass_kg * (1.0 + 1e-12)
    assert 0 < len(surface.marked) <= len(surface.faces) / 2


@pytest.fixture
def t_handle() -> Scenario:
    """Return the scenario whose body is a mesh."""
    return load_scenario("t-handle")


def test_mesh_is_drawn_about_its_centre_of_mass(t_handle: Scenario) -> None:
    """The T-handle has its ten faces, two of them of eight corners, and its own volume and centre."""
    surface = surface_of(t_handle.body)
    assert sorted(map(len, surface.faces)) == [4] * 8 + [8] * 2
    assert_closed(surface)
    corner = np.array([0.05, 0.07, 0.01]) - [0.0, 2e-5 * 0.025 / 6e-5 + 4e-5 * 0.06 / 6e-5, 0.0]
    farthest = float(np.linalg.norm(corner))
    assert volume(surface.vertices, surface.faces) * (farthest / REACH) ** 3 == pytest.approx(6e-5)
    assert np.abs(surface.vertices - corner * REACH / farthest).sum(axis=1).min() < 1e-6


def test_stored_scenario_keeps_the_mesh(t_handle: Scenario) -> None:
    """The surface survives writing and reading; a run that lacks it has the same definition, and a box."""
    reported = serialized(t_handle)
    again = deserialized(reported, "here")
    assert np.array_equal(surface_of(again.body).vertices, surface_of(t_handle.body).vertices)
    older = serialized(t_handle)
    del older["body"]["mesh"]["surface"]
    assert not redefined({"scenarios": {"one": older}}, {"scenarios": {"one": reported}})
    box = surface_of(deserialized(older, "here").body)
    assert (len(box.faces), box.name) == (6, "a box of the same inertia")


@pytest.mark.parametrize(
    "surface", ["v 0 0", "f 1 2 3\n", "v 0 0 0\n", ["v"], "v 0 0 0\n" * 3 + "f 1 2 3\n" * 601]
)
def test_damaged_surface_is_refused(surface: object, t_handle: Scenario) -> None:
    """A stored surface that cannot be drawn is a fault of its file, named by its place."""
    reported = serialized(t_handle)
    reported["body"]["mesh"]["surface"] = surface
    with pytest.raises(InputError, match=r"^here: "):
        deserialized(reported, "here")


def bumpy_sphere(rings: int) -> tuple[Array, Array]:
    """Return a closed mesh of 4 rings^2 - 4 rings triangles or so, without symmetries."""
    theta = np.linspace(0.0, np.pi, rings + 1)[1:-1]
    phi = 2.0 * np.pi * np.arange(2 * rings) / (2 * rings)
    t, p = (part.ravel() for part in np.meshgrid(theta, phi, indexing="ij"))
    radius = 1.0 + 0.1 * np.sin(3.0 * p) * np.sin(t) ** 3 + 0.1 * np.cos(2.0 * t)
    inner = radius[:, None] * np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
    vertices = np.concatenate([inner, [[0.0, 0.0, 1.1], [0.0, 0.0, -1.1]]])
    grid = np.arange(len(inner)).reshape(len(theta), -1)
    after = np.roll(grid, -1, axis=1)
    north, south = len(inner), len(inner) + 1
    quads = [grid[:-1], grid[1:], after[1:], after[:-1]]
    a, b, c, d = (part.ravel() for part in quads)
    top = np.stack([np.full(2 * rings, north), grid[0], after[0]], axis=1)
    end = np.stack([np.full(2 * rings, south), after[-1], grid[-1]], axis=1)
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1), top, end])


@pytest.mark.parametrize("rings", [8, 40, 150])
def test_large_mesh_is_decimated(rings: int) -> None:
    """A mesh keeps at most 600 triangles, its size and about its volume; a small one is unchanged."""
    vertices, triangles = bumpy_sphere(rings)
    kept, faces = decimated(vertices, triangles)
    assert len(faces) <= MAX_TRIANGLES
    assert (len(triangles) <= MAX_TRIANGLES) == (len(faces) == len(triangles))
    assert np.allclose(np.ptp(kept, axis=0), np.ptp(vertices, axis=0), rtol=0.2)
    whole = volume(vertices, tuple(map(tuple, triangles)))
    assert volume(kept, tuple(map(tuple, faces))) == pytest.approx(whole, rel=0.12)
    again, corners = read_obj_text(obj_text(kept, faces))
    assert np.allclose(again, kept, atol=3e-5)
    assert np.array_equal(corners, faces)


def test_plate_with_a_hole_keeps_its_triangles() -> None:
    """An annular region has no single outline, so it is drawn by its triangles."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    vertices = np.column_stack([np.concatenate([2.0 * square, square]), np.zeros(8)])
    k = np.arange(4)
    after = (k + 1) % 4
    triangles = np.concatenate(
        [np.stack([k, after, 4 + after], axis=1), np.stack([k, 4 + after, 4 + k], axis=1)]
    )
    assert sorted(polygons_of(vertices, triangles)) == sorted(map(tuple, triangles.tolist()))
    filled = np.concatenate([triangles, [[4, 5, 6], [4, 6, 7]]])
    (outline,) = polygons_of(vertices, filled)
    assert sorted(outline) == [0, 1, 2, 3]


@pytest.mark.slow
def test_many_triangles_in_a_file_reach_the_scenario(tmp_path: Path) -> None:
    """A mesh file of 22,000 triangles is kept with at most 600 in the run."""
    vertices, triangles = bumpy_sphere(75)
    (tmp_path / "part.obj").write_text(obj_text(vertices, triangles), encoding="utf-8")
    (tmp_path / "one.toml").write_text(
        'name = "one"\nduration_s = 1.0\nsamples = 11\n[body]\nmesh = "part.obj"\ndensity_kg_m3 = 1000.0\n',
        encoding="utf-8",
    )
    scenario = load_scenario(tmp_path / "one.toml")
    text = serialized(scenario)["body"]["mesh"]["surface"]
    assert 300 < text.count("f ") <= MAX_TRIANGLES
    assert len(text) < 30_000
    assert surface_of(scenario.body).name == "the mesh part.obj"
