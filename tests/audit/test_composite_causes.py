"""Faults in one of several merged links are named; the composites come from point masses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from bodycheck.audit.audit import Body, Difference
from bodycheck.audit.audit_run import AuditOptions, audit
from bodycheck.audit.causes import body_causes
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.exact_arithmetic import doubles
from bodycheck.scenarios.model_files.model_file import ModelFile

INPUTS = Path(__file__).parent / "model_inputs"
URDF = """<robot name="r">
<link name="base"><inertial><origin xyz="0.1 0.02 -0.03" rpy="0.3 -0.2 0.5"/><mass value="2"/>
  <inertia ixx="0.1" ixy="0.01" ixz="-0.02" iyy="0.2" iyz="0.015" izz="0.25"/></inertial></link>
<link name="arm"><inertial><origin xyz="-0.05 0.1 0.2" rpy="-0.4 0.1 0.2"/><mass value="1"/>
  <inertia ixx="0.01" ixy="0.002" ixz="-0.001" iyy="0.012" iyz="0.003" izz="0.011"/></inertial></link>
<link name="tip"><inertial><origin xyz="0 0 0.1" rpy="0.1 0.6 0"/><mass value="0.5"/>
  <inertia ixx="0.001" ixy="0.0001" ixz="0" iyy="0.0012" iyz="0.0002" izz="0.0015"/></inertial></link>
<link name="guard"><collision><origin xyz="0 0 0.02" rpy="0.2 0 0.4"/><geometry><box size="0.1 0.05 0.04"/>
  </geometry></collision></link>
<joint name="a" type="fixed"><parent link="base"/><child link="arm"/>
  <origin xyz="0.3 0.1 0" rpy="0.5 0.2 -0.3"/></joint>
<joint name="t" type="fixed"><parent link="arm"/><child link="tip"/>
  <origin xyz="0 0.2 0.1" rpy="-0.2 0.9 0"/></joint>
<joint name="g" type="fixed"><parent link="base"/><child link="guard"/>
  <origin xyz="0 -0.2 0" rpy="0 0.7 0"/></joint>
</robot>"""
Cloud = tuple[Array, Array]
"""Masses (n,) and places (n, 3)."""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ModelFile:
    """Return a base to which three links are fixed, one of them without inertia."""
    path = tmp_path_factory.mktemp("model") / "r.urdf"
    path.write_text(URDF)
    return read_model(path)


def cloud(mass: float, centre: Array, tensor: Array) -> Cloud:
    """Return six point masses with this mass, centre and tensor."""
    moments, axes = np.linalg.eigh(tensor)
    spread = 0.5 * moments.sum() - moments  # integral of x^2 along each axis
    arms = np.sqrt(3.0 * np.maximum(spread, 0.0) / mass)
    places = np.concatenate([centre + sign * arms[k] * axes[:, k] for k in range(3) for sign in (1, -1)])
    return np.full(6, mass / 6.0), places.reshape(6, 3)


def body_of(clouds: list[Cloud]) -> Body:
    """Return mass, centre and tensor of point masses."""
    masses, places = (np.concatenate(parts) for parts in zip(*clouds, strict=True))
    centre = masses @ places / masses.sum()
    arms = places - centre
    tensor = sum(m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(masses, arms, strict=True))
    return Body(float(masses.sum()), centre, np.asarray(tensor))


def clouds(model: ModelFile, change: Mapping[str, Callable[[Cloud, Array, Array], Cloud | None]]) -> Body:
    """Return the composite, with some links changed: (cloud in link axes, R, p) -> cloud in base axes."""
    found = []
    for link, frame in model.members("base", frozenset({"arm", "tip", "guard"})):
        R, p = doubles(frame.rotation), doubles(frame.position)
        if link.stated is not None:
            one = Body.of(link.stated.in_link)
            here = cloud(one.mass_kg, one.centre_m, one.inertia_kg_m2)
        elif link.name in change:
            x2, y2, z2 = 0.1**2, 0.05**2, 0.04**2
            (shape,) = link.collisions
            Q = doubles(shape.frame.rotation)
            box = Q @ np.diag([y2 + z2, z2 + x2, x2 + y2]) @ Q.T * 0.2 / 12.0
            here = cloud(0.2, doubles(shape.frame.position), box)
        else:
            continue
        there = change[link.name](here, R, p) if link.name in change else (here[0], here[1] @ R.T + p)
        if there is not None:
            found.append(there)
    return body_of(found)


def right(one: Cloud, R: Array, p: Array) -> Cloud:
    """Place a link."""
    return one[0], one[1] @ R.T + p


def unturned(one: Cloud, R: Array, p: Array) -> Cloud:  # noqa: ARG001 - faults are alike
    """Place a link without its rotation."""
    return one[0], one[1] + p


def at_origin(one: Cloud, R: Array, p: Array) -> Cloud:  # noqa: ARG001 - faults are alike
    """Turn a link, and leave it at the origin."""
    return one[0], one[1] @ R.T


def lost(one: Cloud, R: Array, p: Array) -> None:
    """Leave a link out."""


FAULTS: dict[str, dict[str, Callable[[Cloud, Array, Array], Cloud | None]]] = {
    "0.2 kg invented for guard, without inertia in the file, from its collision shapes at 1000 kg/m^3": {
        "guard": right
    },
    "merged links lost: tip": {"tip": lost},
    "merged links lost: arm and tip": {"arm": lost, "tip": lost},
    "rotation of the merged links ignored: tip": {"tip": unturned},
    "rotation of the merged links ignored: arm and tip": {"arm": unturned, "tip": unturned},
    "position of the merged links ignored: arm": {"arm": at_origin},
}


def causes(model: ModelFile, imported: Body) -> tuple[str, ...]:
    """Return the causes of an import of the base with all that is fixed to it."""
    absent = frozenset({"arm", "tip", "guard"})
    combined = model.merged("base", absent)
    assert combined is not None
    expected = Body.of(combined)
    difference = Difference.between(expected, imported)
    return body_causes(model, model.members("base", absent), expected, imported, difference, "")


@pytest.mark.parametrize("cause", FAULTS)
def test_fault_in_a_merged_link_is_named(cause: str, model: ModelFile) -> None:
    """Mass, centre and tensor of the composite have one cause."""
    assert causes(model, clouds(model, FAULTS[cause])) == (cause,)


def test_right_composite_has_no_fault(model: ModelFile) -> None:
    """The composite of point masses is that of the file, to round-off."""
    (cause,) = causes(model, clouds(model, {}))
    assert cause.startswith("rounded: ")


def test_fault_in_the_tensor_of_one_member_is_named(model: ModelFile) -> None:
    """Off-diagonals that are dropped in one link only."""

    def diagonal(one: Cloud, R: Array, p: Array) -> Cloud:
        link = model.by_name["arm"]
        assert link.stated is not None
        J, Q = doubles(link.stated.inertia.tensor), doubles(link.stated.frame.rotation)
        body = body_of([one])
        return right(cloud(body.mass_kg, body.centre_m, Q @ np.diag(np.diagonal(J)) @ Q.T), R, p)

    (cause,) = causes(model, clouds(model, {"arm": diagonal}))
    assert cause == "off-diagonals dropped, in arm only"


def test_mass_that_mujoco_invents_for_a_fixed_child_is_named() -> None:
    """A guard without inertia, fixed to the hip, weighs 0.2 kg in MuJoCo and moves the hip's centre."""
    found = audit(INPUTS / "arm.urdf", AuditOptions(["mujoco"], spins=False))
    (hip,) = [link for link in found.links if link.name == "hip"]
    assert hip.held["mujoco:default"].causes == (
        "0.2 kg invented for guard, without inertia in the file, from its collision shapes at 1000 kg/m^3",
    )
