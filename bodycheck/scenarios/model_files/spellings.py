"""One free body, written in many ways: model files that state the same mass, centre and tensor.

Each spelling is exact up to the rounding of its numbers to doubles. `g and mm` states another body, 1e3 times
as heavy and long, whose free rotation is the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.model_files.exact import (
    Exact,
    ExactInertia,
    Frame,
    doubles,
    exact,
    mp,
    rotation_of_rpy,
)
from bodycheck.scenarios.model_files.model_file import Format

_MASS, _CENTRE = 2.5, (0.08, -0.05, 0.12)
_MOMENTS, _AXES_RPY = (0.031, 0.052, 0.067), (0.4, -0.7, 1.1)
_RPY = (0.3, 0.9, -0.5)
_SMALL = (
    (0.2, (0.05, 0.02, -0.03), (1e-3, 2e-3, 2.5e-3), (0.2, 0.1, -0.4)),
    (0.1, (-0.02, 0.04, 0.01), (8e-4, 1e-3, 1.5e-3), (-0.6, 0.3, 0.2)),
)
"""Mass, centre, moments and axes of the parts that become children."""
_POSES = (((0.03, 0.01, 0.02), (0.5, -0.2, 0.8)), ((0.02, -0.01, 0.04), (-0.3, 0.6, 0.1)))
"""Position and fixed-axis angles of each child in its parent."""


@dataclass(frozen=True)
class Spelling:
    """A model file of the body: name, format and text; all its links are fixed to each other."""

    name: str
    format: Format
    text: str


def body() -> ExactInertia:
    """Return the body of all spellings, in the axes of the root link."""
    return _placed(_MASS, _CENTRE, _MOMENTS, _AXES_RPY)


def _placed(
    mass: float, centre: Sequence[float], moments: Sequence[float], rpy: Sequence[float]
) -> ExactInertia:
    R = rotation_of_rpy(rpy)
    return ExactInertia(mp.mpf(mass), exact(centre), R @ exact(np.diag(moments)) @ R.T)


def spellings() -> tuple[Spelling, ...]:
    """Return the family, URDF first."""
    return (*_urdf_spellings(), *_mjcf_spellings())


# ------------------------------------------------------------------------------------------------------ URDF


def _urdf_spellings() -> Iterator[Spelling]:
    total = body()
    yield _urdf("off-diagonals", _urdf_link("body", total, (0.0, 0.0, 0.0)))
    yield _urdf("principal inertial frame", _urdf_principal())
    yield _urdf("rotated inertial frame", _urdf_link("body", total, _RPY))
    scaled = ExactInertia(total.mass * 1000, total.centre * 1000, total.tensor * mp.mpf(10) ** 9)
    yield _urdf("g and mm", _urdf_link("body", scaled, _RPY))
    rest, parts = _split(1)
    yield _urdf("welded child", _urdf_chain(rest, parts))
    rest, parts = _split(2)
    yield _urdf("nested fixed children", _urdf_chain(rest, parts))
    yield _urdf("negative-z axis on the fixed joint", _urdf_chain(rest, parts, axis="0 0 -1"))


def _urdf(name: str, content: str) -> Spelling:
    return Spelling(name, "urdf", f'<robot name="spelling">\n{content}</robot>\n')


def _urdf_principal() -> str:
    moments = dict(zip(("ixx", "iyy", "izz"), _MOMENTS, strict=True))
    return _urdf_inertial("body", _MASS, _CENTRE, _AXES_RPY, moments)


def _urdf_link(name: str, inertia: ExactInertia, rpy: Sequence[float]) -> str:
    """Write an inertia in an inertial frame that is rotated by rpy: R^T I R."""
    R = rotation_of_rpy(rpy)
    J = doubles(R.T @ inertia.tensor @ R)
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = {word: float(J[place]) for word, place in names.items()}
    return _urdf_inertial(name, float(inertia.mass), doubles(inertia.centre).tolist(), rpy, values)


def _urdf_inertial(
    name: str, mass: float, centre: Sequence[float], rpy: Sequence[float], values: dict[str, float]
) -> str:
    tensor = " ".join(
        f'{word}="{values.get(word, 0.0)!r}"' for word in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    return (
        f'  <link name="{name}"><inertial><origin xyz="{_words(centre)}" rpy="{_words(rpy)}"/>'
        f'<mass value="{mass!r}"/><inertia {tensor}/></inertial></link>\n'
    )


def _urdf_chain(rest: ExactInertia, parts: Sequence[ExactInertia], axis: str = "") -> str:
    content = _urdf_link("body", rest, _RPY)
    parent = "body"
    for k, (part, (xyz, rpy)) in enumerate(zip(parts, _POSES, strict=False)):
        content += _urdf_link(f"part{k}", part, _RPY)
        along = f'<axis xyz="{axis}"/>' if axis else ""
        content += (
            f'  <joint name="joint{k}" type="fixed"><parent link="{parent}"/><child link="part{k}"/>'
            f'<origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>{along}</joint>\n'
        )
        parent = f"part{k}"
    return content


# ------------------------------------------------------------------------------------------------------ MJCF


def _mjcf_spellings() -> Iterator[Spelling]:
    total = body()
    yield _mjcf("fullinertia", _mjcf_full(total))
    R = rotation_of_rpy(_AXES_RPY)
    at = f'pos="{_words(_CENTRE)}" mass="{_MASS!r}" diaginertia="{_words(_MOMENTS)}"'
    yield _mjcf("diaginertia and quat", f'<inertial {at} quat="{_words(_quaternion(R))}"/>')
    yield _mjcf("diaginertia and euler", f'<inertial {at} euler="{_words(_AXES_RPY)}"/>', 'eulerseq="XYZ"')
    axes = doubles(R)
    yield _mjcf("diaginertia and xyaxes", f'<inertial {at} xyaxes="{_words([*axes[:, 0], *axes[:, 1]])}"/>')
    rest, parts = _split(1)
    yield _mjcf("welded child", _mjcf_full(rest) + _mjcf_children(parts))
    rest, parts = _split(2)
    yield _mjcf("nested welded children", _mjcf_full(rest) + _mjcf_children(parts))
    yield _mjcf("welded children, fused", _mjcf_full(rest) + _mjcf_children(parts), 'fusestatic="true"')


def _mjcf(name: str, content: str, settings: str = "") -> Spelling:
    text = (
        f'<mujoco model="spelling">\n<compiler angle="radian" {settings}/>\n<worldbody>\n'
        f'<body name="body"><joint type="free"/>{content}</body>\n</worldbody>\n</mujoco>\n'
    )
    return Spelling(name, "mjcf", text)


def _mjcf_full(inertia: ExactInertia) -> str:
    J = doubles(inertia.tensor)
    full = [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]]
    return (
        f'<inertial pos="{_words(doubles(inertia.centre))}" mass="{float(inertia.mass)!r}" '
        f'fullinertia="{_words(full)}"/>'
    )


def _mjcf_children(parts: Sequence[ExactInertia], k: int = 0) -> str:
    if k == len(parts):
        return ""
    xyz, rpy = _POSES[k]
    quaternion = _words(_quaternion(rotation_of_rpy(rpy)))
    inside = _mjcf_full(parts[k]) + _mjcf_children(parts, k + 1)
    return f'<body name="part{k}" pos="{_words(xyz)}" quat="{quaternion}">{inside}</body>'


# ------------------------------------------------------------------------------------------ parts of the body


def _part(k: int) -> ExactInertia:
    return _placed(*_SMALL[k])


def _split(count: int) -> tuple[ExactInertia, list[ExactInertia]]:
    """Return the rest of the body and its nested parts in their own axes; their composite is the body."""
    parts = [_part(k) for k in range(count)]
    frame, left = Frame.of(), body()
    for part, (xyz, rpy) in zip(parts, _POSES, strict=False):
        frame = frame @ Frame.of(xyz, rotation_of_rpy(rpy))
        left = _remainder(left, part.placed(frame))
    return left, parts


def _remainder(total: ExactInertia, part: ExactInertia) -> ExactInertia:
    """Return the body whose composite with `part` is `total`."""
    mass = total.mass - part.mass
    centre = (total.mass * total.centre - part.mass * part.centre) / mass
    rest = ExactInertia(mass, centre, total.tensor)
    tensor = (
        total.tensor
        - part.tensor
        - part.steiner(part.centre - total.centre)
        - rest.steiner(centre - total.centre)
    )
    return ExactInertia(mass, centre, tensor)


def _quaternion(R: Exact) -> Array:
    from bodycheck.reference_impl.rotations import matrix_to_quaternion

    return matrix_to_quaternion(doubles(R))


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))
