"""URDF links with primitives and meshes whose tensors are right, or have one planted slip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bodycheck.reference_impl.arrays import Array


@dataclass
class Solid:
    """A part at unit density: its element below <geometry>, volume, tensor about its centre, and its pose."""

    geometry: str
    volume: float
    tensor: Array
    centre: Array
    R: Array
    rpy: Array
    position: Array
    kind: str
    sizes: Array

    @property
    def turned(self) -> Array:
        """The tensor in link axes."""
        return np.asarray(self.R @ self.tensor @ self.R.T)

    @property
    def at(self) -> Array:
        """The centre in link axes."""
        return np.asarray(self.R @ self.centre + self.position)


def steiner(m: float, d: Array) -> Array:
    """m (|d|^2 1 - d d^T)."""
    return np.asarray(m * (d @ d * np.eye(3) - np.outer(d, d)))


def _sizes(rng: np.random.Generator, count: int) -> Array:
    return np.round(10.0 ** rng.uniform(-1.7, -0.2, count), 3)


def random_solid(rng: np.random.Generator, folder: Path, kind: str, *, away: bool) -> Solid:
    """Return a box, cylinder, sphere, capsule or mesh with a random pose."""
    rpy = [np.zeros(3), np.array([np.pi / 2, 0.0, 0.0]), np.round(rng.uniform(-3, 3, 3), 3)][rng.integers(3)]
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    position = np.round(rng.uniform(-0.5, 0.5, 3), 3) if away else np.zeros(3)
    centre = np.zeros(3)
    if kind == "box":
        s = _sizes(rng, 3)
        volume, squares = float(np.prod(s)), s**2
        tensor = np.diag(volume / 12.0 * (squares.sum() - squares))
        geometry = f'<box size="{s[0]} {s[1]} {s[2]}"/>'
    elif kind == "sphere":
        s = _sizes(rng, 1)
        volume = 4.0 / 3.0 * np.pi * s[0] ** 3
        tensor = 0.4 * volume * s[0] ** 2 * np.eye(3)
        geometry = f'<sphere radius="{s[0]}"/>'
    elif kind in ("cylinder", "capsule"):
        s = _sizes(rng, 2)
        r, length = s
        volume = np.pi * r**2 * length
        across, along = volume * (3 * r**2 + length**2) / 12.0, volume * r**2 / 2.0
        if kind == "capsule":
            ball = 4.0 / 3.0 * np.pi * r**3
            across += ball * (0.4 * r**2 + length**2 / 4 + 3 * length * r / 8)
            along += 0.4 * ball * r**2
            volume += ball
        tensor = np.diag([across, across, along])
        geometry = f'<{kind} radius="{r}" length="{length}"/>'
    else:
        s = np.empty(0)
        points = rng.normal(size=(rng.integers(6, 20), 3)) * _sizes(rng, 3)
        hull = ConvexHull(points)
        faces = [
            face if np.linalg.det(points[face] - points.mean(axis=0)) > 0 else face[::-1]
            for face in hull.simplices
        ]
        name = f"mesh{rng.integers(1 << 60)}.obj"
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
        (folder / name).write_text("\n".join(lines))
        volume, centre, tensor = _tetrahedra(points, np.array(faces))
        geometry = f'<mesh filename="{name}"/>'
    return Solid(geometry, float(volume), tensor, centre, R, rpy, position, kind, s)


def _tetrahedra(points: Array, faces: Array) -> tuple[float, Array, Array]:
    """Return volume, centre and tensor by the tetrahedra about the mean of the points."""
    origin = points.mean(axis=0)
    a = points[faces] - origin
    volumes = np.linalg.det(a) / 6.0
    first = np.einsum("t,tki->i", volumes, a) / 4.0
    total = a.sum(axis=1)
    second = (
        np.einsum("t,tki,tkj->ij", volumes, a, a) + np.einsum("t,ti,tj->ij", volumes, total, total)
    ) / 20.0
    centre = first / volumes.sum()
    second -= volumes.sum() * np.outer(centre, centre)
    return float(volumes.sum()), centre + origin, np.trace(second) * np.eye(3) - second


@dataclass
class Link:
    """A link of parts with these masses, and roll, pitch and yaw of the inertial frame in the link."""

    solids: list[Solid]
    mass: float
    masses: Array
    rpy: Array
    digits: int

    @property
    def centre(self) -> Array:
        """The centre of mass in link axes."""
        return sum((m * s.at for m, s in zip(self.masses, self.solids, strict=True)), np.zeros(3)) / self.mass

    @property
    def tensor(self) -> Array:
        """The tensor about the centre of mass in link axes."""
        c = self.centre
        return sum(
            (
                m / s.volume * s.turned + steiner(m, s.at - c)
                for m, s in zip(self.masses, self.solids, strict=True)
            ),
            np.zeros((3, 3)),
        )

    @property
    def axes(self) -> Array:
        """The axes of the inertial frame in the link."""
        return np.asarray(Rotation.from_euler("xyz", self.rpy).as_matrix())

    @property
    def written(self) -> Array:
        """The right tensor in the axes of the inertial frame."""
        return self.in_inertial(self.tensor)

    def in_inertial(self, tensor: Array) -> Array:
        """Return a tensor in link axes in those of the inertial frame."""
        return np.asarray(self.axes.T @ tensor @ self.axes)

    def text(self, name: str, written: Array, visual: bool) -> str:
        """Return the link of a URDF that states a tensor (3, 3) in the axes of the inertial frame."""
        tag = "visual" if visual else "collision"
        origin = '<origin xyz="{}" rpy="{}"/>'
        shapes = "".join(
            f"<{tag}>{origin.format(_row(s.position), _row(s.rpy))}<geometry>{s.geometry}</geometry></{tag}>"
            for s in self.solids
        )
        scale = np.max(np.abs(written))
        rounded = np.array([float(f"{x:.{self.digits}g}") for x in written.flat]).reshape(3, 3)
        rounded[np.abs(written) < 1e-14 * scale] = 0.0
        numbers = " ".join(
            f'i{"xyz"[i]}{"xyz"[j]}="{float(rounded[i, j])!r}"' for i in range(3) for j in range(i, 3)
        )
        return (
            f'<link name="{name}"><inertial><origin xyz="{_row(self.centre)}" rpy="{_row(self.rpy)}"/>'
            f'<mass value="{self.mass!r}"/><inertia {numbers}/></inertial>{shapes}</link>'
        )


def _row(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def random_link(rng: np.random.Generator, folder: Path, kind: str, *, even: bool = True) -> Link:
    """Return a link of one shape, or of `several`; even: of uniform density."""
    if kind == "several":
        count = int(rng.integers(2, 5))
        kinds = rng.choice(["box", "cylinder", "sphere", "capsule"], count)
        solids = [random_solid(rng, folder, str(one), away=True) for one in kinds]
    else:
        solids = [random_solid(rng, folder, kind, away=bool(rng.integers(2)))]
    mass = float(np.round(10.0 ** rng.uniform(-1.5, 1.5), 3))
    weights = np.array([s.volume for s in solids])
    if not even:
        weights = weights * 10.0 ** rng.uniform(-1, 1, len(solids))
    rpy = solids[0].rpy if rng.integers(2) else np.zeros(3)
    return Link(solids, mass, mass * weights / weights.sum(), rpy, int(rng.choice([6, 8, 17])))


def _permuted(link: Link, rng: np.random.Generator) -> Array:
    order = [(0, 2, 1), (2, 1, 0), (1, 0, 2), (1, 2, 0), (2, 0, 1)][rng.integers(5)]
    return link.written[np.ix_(order, order)]


def _z_for_y(link: Link, rng: np.random.Generator) -> Array:
    (s,) = link.solids
    x, y, z = s.sizes**2
    wrong = [(y + z, x + z, x + z), (y + z, x + y, x + y), (y + y, x + z, x + y)][rng.integers(3)]
    return link.in_inertial(link.mass / 12.0 * s.R @ np.diag(wrong) @ s.R.T)


def _twelve_for_five(link: Link, rng: np.random.Generator) -> Array:
    tensor = link.written.copy()
    axis = rng.integers(3)
    tensor[axis, axis] *= 2.4
    return tensor


def _of_radius(link: Link, radius: float) -> Array:
    (s,) = link.solids
    length = s.sizes[1] if len(s.sizes) > 1 else 0.0
    across, along = (3 * radius**2 + length**2) / 12.0, radius**2 / 2.0
    if s.kind == "sphere":
        across = along = 0.4 * radius**2
    return link.in_inertial(link.mass * s.R @ np.diag([across, across, along]) @ s.R.T)


def _sum_of(link: Link) -> Array:
    turned = [m / s.volume * s.turned for m, s in zip(link.masses, link.solids, strict=True)]
    return link.in_inertial(np.sum(turned, axis=0))


def _about_the_end(link: Link) -> Array:
    (s,) = link.solids
    return link.in_inertial(link.tensor + steiner(link.mass, s.R[:, 2] * s.sizes[-1] / 2.0))


_ANY = ("box", "cylinder", "capsule", "mesh", "several")
SLIPS: dict[str, tuple[Callable[[Link, np.random.Generator], Array], tuple[str, ...]]] = {
    "permuted axes": (_permuted, _ANY),
    "about the link's origin": (
        lambda link, _: link.in_inertial(link.tensor + steiner(link.mass, link.centre)),
        _ANY,
    ),
    "no parallel axis": (lambda link, _: _sum_of(link), ("several",)),
    "mass missing": (lambda link, _: link.written / link.mass, _ANY),
    "diameter for radius": (
        lambda link, _: _of_radius(link, 2.0 * link.solids[0].sizes[0]),
        ("cylinder", "sphere"),
    ),
    "z for y": (_z_for_y, ("box",)),
    "12 for 5": (_twelve_for_five, _ANY),
    "mm": (lambda link, _: 1e6 * link.written, _ANY),
    "rotation left out": (
        lambda link, _: link.mass / link.solids[0].volume * link.solids[0].tensor,
        ("box", "cylinder", "capsule", "mesh"),
    ),
    "products of the wrong sign": (
        lambda link, _: 2.0 * np.diag(np.diagonal(link.written)) - link.written,
        _ANY,
    ),
    "about the end": (lambda link, _: _about_the_end(link), ("cylinder", "box")),
    "moved to the centre twice": (
        lambda link, _: link.in_inertial(link.tensor - steiner(link.mass, link.centre)),
        _ANY,
    ),
}
"""Slip -> the tensor that it writes, and the shapes that it can be made with."""


def changes_enough(link: Link, written: Array) -> bool:
    """Return whether a tensor has a moment that is 10 % off, and equals no change of density."""
    right = link.written
    pairs = [
        (np.diagonal(written), np.diagonal(right)),
        (np.linalg.eigvalsh(written), np.linalg.eigvalsh(right)),
    ]
    if max(float(np.max(np.abs(a - b) / b)) for a, b in pairs) < 0.1:
        return False
    scale = np.max(np.abs(written))
    return not np.allclose(written, written[0, 0] / right[0, 0] * right, rtol=1e-3, atol=1e-3 * scale)


def is_right(numbers: tuple[float, ...] | None, link: Link) -> bool:
    """Return whether numbers of a finding (xx, xy, xz, yy, yz, zz) are those of the link."""
    right = link.written[np.triu_indices(3)]
    return numbers is not None and bool(
        np.allclose(numbers, right, rtol=1e-4, atol=1e-4 * np.max(np.abs(right)))
    )


def chain(count: int, factors: tuple[float, float, float] | None) -> str:
    """Return a URDF of a chain of boxes with moments right up to factors; None: without inertia."""
    lines = ['<robot name="r">']
    for k in range(count):
        edges = np.array([0.1 + 0.001 * (k % 37), 0.2 + 0.001 * (k % 11), 0.3])
        x, y, z = edges.tolist()
        content = ""
        if factors is not None:
            xx, yy, zz = (np.array(factors) * 2.0 / 12.0 * (edges @ edges - edges**2)).tolist()
            origin = f'<origin xyz="0.1 0 0" rpy="0.1 0.2 {0.001 * k}"/>'
            shape = f'{origin}<geometry><box size="{x} {y} {z}"/></geometry>'
            content = (
                f'<inertial>{origin}<mass value="2"/><inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" '
                f'izz="{zz}"/></inertial><visual>{shape}</visual><collision>{shape}</collision>'
            )
        lines.append(f'<link name="l{k}">{content}</link>')
        if k:
            kind = "fixed" if factors is None else "continuous"
            lines.append(
                f'<joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/>'
                f'<origin xyz="0 0 0.3" rpy="0 {0.001 * k} 0"/></joint>'
            )
    return "\n".join([*lines, "</robot>"])
