"""Write USD stages as text, from the same numbers as a URDF, with or without the mistakes of converters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import matrix_to_quaternion, quaternion_to_matrix


@dataclass
class Link:
    """Mass in kg, centre (3,) in m and tensor (3, 3) about it in link axes, pose in the world."""

    name: str
    mass: float
    centre: Sequence[float]
    tensor: Array
    position: Sequence[float] = (0.0, 0.0, 0.0)
    parent: str = ""
    joint: str = "revolute"
    extra: str = ""
    principal: tuple[Array, Array] = field(init=False)

    def __post_init__(self) -> None:
        moments, axes = np.linalg.eigh(self.tensor)
        self.principal = moments, axes * np.linalg.det(axes)


def tensor(values: Sequence[float]) -> Array:
    """Return a tensor (3, 3) of xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def urdf(links: Sequence[Link]) -> str:
    """Return links as URDF, each connected to its parent at its position."""
    where = {link.name: np.array(link.position) for link in links}
    text = '<robot name="made">\n'
    for link in links:
        J = link.tensor
        numbers = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), J[np.triu_indices(3)].tolist(), strict=True)
        inertia = " ".join(f'{name}="{value!r}"' for name, value in numbers)
        text += (
            f'<link name="{link.name}"><inertial><origin xyz="{_words(link.centre)}"/>'
            f'<mass value="{link.mass!r}"/><inertia {inertia}/>'
            "</inertial></link>\n"
        )
        if link.parent:
            at = where[link.name] - where[link.parent]
            text += (
                f'<joint name="to_{link.name}" type="{"fixed" if link.joint == "fixed" else "continuous"}">'
                f'<parent link="{link.parent}"/><child link="{link.name}"/><origin xyz="{_words(at)}"/>'
                '<axis xyz="0 0 1"/></joint>\n'
            )
    return text + "</robot>\n"


def _words(values: Sequence[float] | Array) -> str:
    return " ".join(repr(float(x)) for x in values)


@dataclass
class Stage:
    """How links are written: units, up axis, and the mistakes.

    moments, centres, masses: factors by which the numbers are wrong. axes: principal axes as they are, lost,
    inverted, or relabelled (which changes nothing).
    """

    metre: float = 1.0
    kilogram: float = 1.0
    up: str = "Z"
    moments: float = 1.0
    centres: float = 1.0
    masses: float = 1.0
    axes: str = "kept"
    diagonal_only: bool = False
    turned: Array | None = None

    def text(self, links: Sequence[Link]) -> str:
        """Return the stage."""
        body = "".join(self._body(link) for link in links)
        joints = "".join(
            f'  def Physics{link.joint.capitalize()}Joint "to_{link.name}" {{\n'
            f"    rel physics:body0 = </robot/{link.parent}>\n"
            f"    rel physics:body1 = </robot/{link.name}>\n  }}\n"
            for link in links
            if link.parent
        )
        return (
            f'#usda 1.0\n(\n  defaultPrim = "robot"\n  metersPerUnit = {self.metre!r}\n'
            f'  kilogramsPerUnit = {self.kilogram!r}\n  upAxis = "{self.up}"\n)\n'
            f'def Xform "robot" {{\n{body}{joints}}}\n'
        )

    def _body(self, link: Link) -> str:
        moments, axes = link.principal
        if self.turned is not None:
            axes = self.turned @ axes
        match self.axes:
            case "lost":
                axes = np.eye(3)
            case "inverted":
                axes = axes.T
            case "relabelled":
                moments, axes = moments[[2, 0, 1]], axes[:, [2, 0, 1]] * np.array([-1.0, 1.0, -1.0])
        if self.diagonal_only:
            moments, axes = np.diagonal(link.tensor), np.eye(3)
        centre = np.array(link.centre) if self.turned is None else self.turned @ np.array(link.centre)
        scale = self.moments / (self.kilogram * self.metre**2)
        quaternion = matrix_to_quaternion(axes)
        assert np.allclose(quaternion_to_matrix(quaternion), axes)
        return (
            f'  def Xform "{link.name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {{\n'
            f"    float physics:mass = {link.mass * self.masses / self.kilogram!r}\n"
            f"    point3f physics:centerOfMass = {_tuple(centre * self.centres / self.metre)}\n"
            f"    float3 physics:diagonalInertia = {_tuple(moments * scale)}\n"
            f"    quatf physics:principalAxes = {_tuple(quaternion)}\n"
            f"    double3 xformOp:translate = {_tuple(np.array(link.position) / self.metre)}\n"
            f'    uniform token[] xformOpOrder = ["xformOp:translate"]\n{link.extra}  }}\n'
        )


def _tuple(values: Sequence[float] | Array) -> str:
    return f"({', '.join(repr(float(x)) for x in values)})"
