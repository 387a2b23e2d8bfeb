"""Meshes of MJCF: what MuJoCo makes of concave and hollow ones stands beside the solid."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from bodycheck.audit.audit import LintFinding
from bodycheck.audit.lint import lint
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.model_files import read_model
from tests.helpers.expected_messages import ExpectedMessage

INPUTS = Path(__file__).parent / "model_inputs"


def written(folder: Path, mesh: str, inertia: str = "", geom: str = 'density="1000"', body: str = "") -> Path:
    """Write a body of one mesh geom."""
    attribute = f' inertia="{inertia}"' if inertia else ""
    path = folder / "part.xml"
    path.write_text(
        f'<mujoco><compiler meshdir="{INPUTS}"/><asset><mesh name="u" file="{mesh}.obj"{attribute}/></asset>'
        f'<worldbody><body name="b"><freejoint/>{body}<geom type="mesh" mesh="u" {geom}/></body></worldbody>'
        "</mujoco>"
    )
    return path


def found(path: Path) -> list[LintFinding]:
    """Return the findings about meshes."""
    return [one for one in lint(read_model(path)) if one.rule == "mesh-inertia"]


@pytest.mark.parametrize("mesh", ["U", "hollow"])
@pytest.mark.parametrize("inertia", ["", "legacy", "convex", "exact", "shell"])
def test_mesh_that_does_not_weigh_what_its_solid_weighs_is_reported(
    mesh: str, inertia: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The U weighs 7 kg, the hollow cube 26 kg; the finding has this mass and the one that MuJoCo holds."""
    path = written(tmp_path, mesh, inertia)
    held = float(mujoco.MjModel.from_xml_path(str(path)).body_mass[1])
    findings = found(path)
    if inertia == "exact":
        assert findings == []
        assert held == pytest.approx({"U": 7.0, "hollow": 26.0}[mesh], rel=1e-6)  # in single precision
        return
    (one,) = findings
    assert (one.severity, one.line) == ("note" if inertia == "shell" else "warning", 1)
    assert f"holds {held:.4g} kg" in one.message
    expected_message(f"{one.message}; expected: {one.expected}", tmp_path)


def test_mesh_of_given_mass_is_compared_by_its_moments(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """With mass="5" only centre and tensor differ; MuJoCo's largest moment stands in the message."""
    path = written(tmp_path, "U", geom='mass="5"')
    (one,) = found(path)
    largest = float(mujoco.MjModel.from_xml_path(str(path)).body_inertia[1].max())
    assert f"largest moment {largest:.4g} kg m^2" in one.message
    expected_message(one.message, tmp_path)


def _hollow(case: str) -> tuple[Array, Triangles]:
    """Return a hollow cube as MuJoCo takes it, with all faces inward, or as two that share an edge."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * [0.1, 0.2, 0.3]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = np.array([face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))])
    outer, inner = corners, 0.5 * corners + [0.025, 0.05, 0.075]
    vertices, triangles = np.concatenate([outer, inner]), np.concatenate([faces, faces[:, ::-1] + 8])
    if case == "inward":
        triangles = triangles[:, ::-1]
    if case == "shared edge":
        vertices = np.concatenate([vertices, outer + np.array([0.1, 0.2, 0.0])])
        beside = np.where(faces == 0, 6, np.where(faces == 1, 7, faces + 16))
        triangles = np.concatenate([triangles, beside])
    return vertices, triangles


@pytest.mark.parametrize("case", ["taken", "inward", "shared edge"])
def test_exact_is_advised_where_mujoco_takes_it(
    case: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """MuJoCo refuses faces that point inward, or that share an edge in the same direction."""
    vertices, triangles = _hollow(case)
    text = (
        f'<mujoco><asset><mesh name="u" vertex="{" ".join(map(repr, vertices.ravel().tolist()))}" '
        f'face="{" ".join(map(str, triangles.ravel()))}"/></asset><worldbody><body name="b"><freejoint/>'
        '<geom type="mesh" mesh="u"/></body></worldbody></mujoco>'
    )
    path = tmp_path / "part.xml"
    path.write_text(text)
    (one,) = found(path)
    expected_message(one.expected)
    exact = text.replace('name="u"', 'name="u" inertia="exact"')
    if case == "taken":
        assert mujoco.MjModel.from_xml_string(exact).body_mass[1] == pytest.approx(5.25, rel=1e-6)
    else:
        with pytest.raises(ValueError, match="misoriented" if case == "inward" else "inconsistent"):
            mujoco.MjModel.from_xml_string(exact)


def test_healthy_meshes_are_not_reported(tmp_path: Path) -> None:
    """Nothing is found where the file states the inertia itself, or where the mesh is convex."""
    inertial = '<inertial pos="0 0 0" mass="7" diaginertia="0.1 0.1 0.1"/>'
    assert found(written(tmp_path, "U", body=inertial)) == []
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * [0.3, 0.2, 0.1]
    words = " ".join(map(repr, corners.ravel().tolist()))
    path = tmp_path / "box.xml"
    path.write_text(
        f'<mujoco><asset><mesh name="u" vertex="{words}"/></asset><worldbody><body name="b"><freejoint/>'
        '<geom type="mesh" mesh="u"/></body></worldbody></mujoco>'
    )
    assert found(path) == []
