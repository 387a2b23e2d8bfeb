"""Random valid URDF, SDFormat and MJCF texts, damaged texts, and composites in 50 digits."""

from __future__ import annotations

import random
from pathlib import Path
from xml.etree import ElementTree

import mpmath
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def random_tensor(rng: np.random.Generator, *, full: bool = True) -> Array:
    """Return the tensor (3, 3) of random point masses, in rotated axes if full."""
    squares = 10.0 ** rng.uniform(-4.0, 0.0) * rng.uniform(0.2, 1.0, 3)
    moments = squares.sum() - squares
    if not full:
        return np.diag(moments)
    R = Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix()
    return np.asarray(R @ np.diag(moments) @ R.T)


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def _inertia(tensor: Array) -> str:
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    return " ".join(f'{name}="{float(tensor[place])!r}"' for name, place in places.items())


def random_urdf(rng: np.random.Generator, *, fixed: bool = False) -> str:
    """Return a URDF of 1 to 6 links with full tensors in rotated inertial frames.

    fixed: whether all joints are fixed.
    """
    count = int(rng.integers(2 if fixed else 1, 7))
    parts = []
    for k in range(count):
        mass = 10.0 ** rng.uniform(-2.0, 1.0)
        tensor = random_tensor(rng, full=bool(rng.random() < 0.8)) * mass
        origin = (
            f'<origin xyz="{_numbers(rng.normal(0.0, 0.1, 3))}" rpy="{_numbers(rng.uniform(-3.1, 3.1, 3))}"/>'
            if rng.random() < 0.8
            else ""
        )
        parts.append(
            f'<link name="link{k}"><inertial>{origin}<mass value="{mass!r}"/><inertia {_inertia(tensor)}/>'
            "</inertial></link>"
        )
    for k in range(1, count):
        kind = "fixed" if fixed else str(rng.choice(["fixed", "revolute", "continuous", "prismatic"]))
        limits = '<limit lower="-1.5" upper="0.5" effort="10" velocity="5"/>'
        axis = rng.choice(["0 0 1", "0 0 -1", "1 0 0", "0 -1 0"])
        parts.append(
            f'<joint name="joint{k}" type="{kind}"><parent link="link{int(rng.integers(0, k))}"/>'
            f'<child link="link{k}"/><origin xyz="{_numbers(rng.normal(0.0, 0.3, 3))}" '
            f'rpy="{_numbers(rng.uniform(-3.1, 3.1, 3))}"/><axis xyz="{axis}"/>'
            f"{limits if kind in ('revolute', 'prismatic') else ''}"
            f'<dynamics damping="{float(rng.choice([0.0, 0.25]))!r}" friction="{0.1 * (k % 2)!r}"/></joint>'
        )
    return f'<?xml version="1.0"?>\n<robot name="random">\n{chr(10).join(parts)}\n</robot>\n'


def sdf_of(urdf: str) -> str:
    """Return the SDFormat file of a URDF of links and joints, with the poses of all links in the model."""
    robot = ElementTree.fromstring(urdf)
    poses = {robot.findall("link")[0].get("name"): (Rotation.identity(), np.zeros(3))}
    parts = []
    for joint in robot.findall("joint"):
        parent, child = (str(joint.find(end).get("link")) for end in ("parent", "child"))
        R, p = poses[parent]
        turned, moved = _frame(joint.find("origin"))
        poses[child] = (R * turned, R.apply(moved) + p)
        axis, dynamics = joint.find("axis").get("xyz"), joint.find("dynamics").items()
        limit, mimic = joint.find("limit"), joint.find("mimic")
        follows = ""
        if mimic is not None:
            inside = "".join(f"<{k}>{mimic.get(k)}</{k}>" for k in ("multiplier", "offset"))
            follows = f'<mimic joint="{mimic.get("joint")}">{inside}</mimic>'
        limits = "" if limit is None else "".join(f"<{k}>{value}</{k}>" for k, value in limit.items())
        parts.append(
            f'<joint name="{joint.get("name")}" type="{joint.get("type")}"><parent>{parent}</parent>'
            f"<child>{child}</child><axis><xyz>{axis}</xyz><limit>{limits}</limit>"
            f"<dynamics>{''.join(f'<{k}>{value}</{k}>' for k, value in dynamics)}</dynamics>{follows}"
            "</axis></joint>"
        )
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        origin = inertial.find("origin")
        own = "" if origin is None else f"<pose>{origin.get('xyz')} {origin.get('rpy')}</pose>"
        moments = "".join(f"<{name}>{value}</{name}>" for name, value in inertial.find("inertia").items())
        R, p = poses[link.get("name")]
        parts.append(
            f'<link name="{link.get("name")}"><pose>{_numbers(p)} {_numbers(R.as_euler("xyz"))}</pose>'
            f"<inertial>{own}<mass>{inertial.find('mass').get('value')}</mass><inertia>{moments}</inertia>"
            "</inertial></link>"
        )
    return f'<sdf version="1.6"><model name="random">\n{chr(10).join(parts)}\n</model></sdf>\n'


def _frame(origin: ElementTree.Element | None) -> tuple[Rotation, Array]:
    assert origin is not None
    xyz, rpy = (np.array([float(x) for x in str(origin.get(name)).split()]) for name in ("xyz", "rpy"))
    return Rotation.from_euler("xyz", rpy), xyz


_GEOMS = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}


def _orientation(rng: np.random.Generator, degrees: bool) -> str:
    turn = 180.0 if degrees else 3.1
    return str(
        rng.choice(
            [
                f'quat="{_numbers(rng.normal(size=4))}"',
                f'euler="{_numbers(rng.uniform(-turn, turn, 3))}"',
                f'axisangle="{_numbers(np.append(rng.normal(size=3), rng.uniform(0.0, turn)))}"',
                f'xyaxes="{_numbers(rng.normal(size=6))}"',
                f'zaxis="{_numbers(rng.normal(size=3))}"',
                "",
            ]
        )
    )


def _geom(rng: np.random.Generator, degrees: bool) -> str:
    kind = str(rng.choice(list(_GEOMS)))
    size = rng.uniform(0.02, 0.2, _GEOMS[kind])
    heavy = str(
        rng.choice([f'mass="{rng.uniform(0.1, 2.0)!r}"', f'density="{rng.uniform(100.0, 3000.0)!r}"', ""])
    )
    shell = 'shellinertia="true"' if kind != "ellipsoid" and rng.random() < 0.2 else ""
    if kind not in ("sphere", "ellipsoid") and rng.random() < 0.3:
        ends = rng.normal(0.0, 0.2, 6)
        return f'<geom type="{kind}" size="{float(size[0])!r}" fromto="{_numbers(ends)}" {heavy} {shell}/>'
    pose = f'pos="{_numbers(rng.normal(0.0, 0.1, 3))}" {_orientation(rng, degrees)}'
    named = "" if rng.random() < 0.5 else 'class="heavy"'
    return f'<geom type="{kind}" size="{_numbers(size)}" {pose} {heavy} {shell} {named}/>'


def _inertial(rng: np.random.Generator, degrees: bool) -> str:
    mass = rng.uniform(0.1, 3.0)
    at = f'pos="{_numbers(rng.normal(0.0, 0.1, 3))}" mass="{mass!r}"'
    if rng.random() < 0.5:
        moments = np.diagonal(random_tensor(rng, full=False))
        return f'<inertial {at} {_orientation(rng, degrees)} diaginertia="{_numbers(moments)}"/>'
    full = random_tensor(rng)[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    return f'<inertial {at} fullinertia="{_numbers(full)}"/>'


def _element(tag: str, attributes: dict[str, str]) -> str:
    return f"<{tag} {' '.join(f'{name}={value!r}' for name, value in attributes.items())}/>"


def _joints(rng: np.random.Generator, name: str, depth: int) -> str:
    """Return one to three hinges and slides, a ball, or at the top a free joint, with or without names."""
    if rng.random() < 0.2:
        named = f'name="ball_{name}"' if rng.random() < 0.5 else ""
        return "<freejoint/>" if depth == 0 else f'<joint {named} type="ball" damping="0.1" armature="0.01"/>'
    found = []
    for k in range(int(rng.integers(1, 4))):
        low = rng.uniform(-3.0, 0.0)
        attributes = {
            "type": str(rng.choice(["hinge", "hinge", "slide"])),
            "axis": _numbers(rng.normal(size=3)),
            "pos": _numbers(rng.normal(0.0, 0.1, 3)),
            "damping": repr(float(rng.uniform(0.0, 1.0))),
            "stiffness": str(rng.choice(["0", "2.5"])),
            "frictionloss": str(rng.choice(["0", "0.1"])),
            "armature": str(rng.choice(["0", "0.05"])),
            "class": str(rng.choice(["main", "heavy"])),
        }
        if rng.random() < 0.7:
            attributes["name"] = f"joint{k}_{name}"
        if rng.random() < 0.5:
            attributes |= {"ref": "0.3", "springref": "-0.2"}
        if rng.random() < 0.5:
            attributes["range"] = f"{low!r} {low + 1.0!r}"
        found.append(_element("joint", attributes))
    return "".join(found)


def random_mjcf(rng: np.random.Generator) -> str:
    """Return an MJCF of nested bodies with inertials or geoms, defaults and compiler settings."""
    (of_joints,) = rng.spawn(1)
    degrees = bool(rng.random() < 0.5)
    settings = [f'angle="{"degree" if degrees else "radian"}"']
    if rng.random() < 0.5:
        settings.append(f'eulerseq="{rng.choice(["xyz", "ZYX", "zxz", "XYZ"])}"')
    if rng.random() < 0.3:
        settings.append(f'inertiafromgeom="{rng.choice(["true", "auto"])}"')
    if rng.random() < 0.2:
        settings.append('boundmass="0.2" boundinertia="0.002"')
    if rng.random() < 0.2:
        settings.append('settotalmass="7.5"')
    if rng.random() < 0.2:
        settings.append('inertiagrouprange="0 2"')
    default = (
        '<default><geom density="800"/><default class="heavy"><geom density="4000" group="1"/>'
        '<joint actuatorfrcrange="-8 8"/>'
        '<default class="heavier"><geom density="9000" group="3"/></default></default></default>'
    )

    def body(name: str, depth: int) -> str:
        inside = [_geom(rng, degrees) for _ in range(int(rng.integers(1, 4)))]
        inside.append(
            '<geom type="box" size="0.1 0.1 0.1" group="0"/>'
        )  # all groups count, so every body has mass
        if rng.random() < 0.4:
            inside.append(_inertial(rng, degrees))
        if rng.random() < 0.3:
            inside.append(
                f'<frame pos="0.1 0.2 0.3" {_orientation(rng, degrees)}>{_geom(rng, degrees)}</frame>'
            )
        joint = _joints(of_joints, name, depth) if rng.random() < 0.7 else ""
        children = [
            body(f"{name}_{k}", depth + 1) for k in range(int(rng.integers(0, 3)) if depth < 2 else 0)
        ]
        childclass = str(rng.choice(['childclass="heavy"', 'childclass="heavier"', ""])) if depth else ""
        pose = f'pos="{_numbers(rng.normal(0.0, 0.3, 3))}" {_orientation(rng, degrees)}'
        return f'<body name="{name}" {pose} {childclass}>{joint}{"".join(inside)}{"".join(children)}</body>\n'

    world = "".join(body(f"body{k}", 0) for k in range(int(rng.integers(1, 3))))
    return (
        f'<mujoco model="random">\n<compiler {" ".join(settings)}/>\n{default}\n'
        f"<worldbody>\n{world}</worldbody>\n</mujoco>\n"
    )


_INSERTS = (
    b"<!DOCTYPE robot [<!ENTITY a 'aaaaaaaaaa'><!ENTITY b '&a;&a;&a;&a;&a;&a;&a;'>]>",
    b"<!DOCTYPE robot [<!ENTITY x SYSTEM 'file:///etc/passwd'>]>",
    b'<include file="/etc/passwd"/>',
    b'<include file="../../outside.xml"/>',
    b'<mesh filename="../../../etc/passwd"/>',
    *(b"nan", b"inf", b"1e999", b"-0", b"&lt;", b"&a;", b"\x00", b"\xff", b"<", b">", b'"', b"</body>"),
    *(b"1e308", b"-1", b"0 0 0", b"<link name='link0'/>", b"<body name='body0'/>", b"9" * 5000),
)


def mutated(content: bytes, rng: random.Random) -> bytes:
    """Return content with 1 to 4 damages: bytes changed, spans cut, doubled or swapped, text inserted."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 2)):
        a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
        b = min(b, a + rng.choice((1, 4, 30, 300)))
        match rng.randrange(5):
            case 0 if a < len(data):
                data[a] = rng.randrange(256)
            case 1:
                del data[a:b]
            case 2:
                data[a:a] = data[a:b]
            case 3:
                data[a:b] = rng.choice(_INSERTS)
            case _:
                quotes = [k for k in range(len(data)) if data[k] == 34] or [0]
                at = rng.choice(quotes) + 1
                data[at:at] = rng.choice(_INSERTS)
    return bytes(data)


def composite_50_digits(path: Path) -> tuple[float, Array, Array]:
    """Return mass, centre and tensor of all links of a URDF, from second moments about the root's origin.

    S = sum R_k (C_k + m c c^T) R_k^T ..., C = tr(I)/2 1 - I: a way other than by tensors and arms.
    """
    with mpmath.workdps(50):
        root = ElementTree.parse(path).getroot()
        poses: dict[str, mpmath.matrix] = {}
        joints = root.findall("joint")
        children = {joint.find("child").get("link") for joint in joints}  # type: ignore[union-attr]
        (base,) = (link.get("name") for link in root.findall("link") if link.get("name") not in children)
        poses[str(base)] = mpmath.eye(4)
        while len(poses) < len(joints) + 1:
            for joint in joints:
                parent, child = joint.find("parent").get("link"), joint.find("child").get("link")  # type: ignore[union-attr]
                if parent in poses:
                    poses[str(child)] = poses[str(parent)] * _pose(joint)
        second = mpmath.zeros(4)
        for link in root.findall("link"):
            inertial = link.find("inertial")
            assert inertial is not None
            mass = mpmath.mpf(float(inertial.find("mass").get("value")))  # type: ignore[union-attr,arg-type]
            given = inertial.find("inertia").attrib  # type: ignore[union-attr]
            tensor = mpmath.matrix(
                [[float(given["i" + "".join(sorted(a + b))]) for b in "xyz"] for a in "xyz"]
            )
            half_trace = (tensor[0, 0] + tensor[1, 1] + tensor[2, 2]) / 2
            own = mpmath.zeros(4)
            for i in range(3):
                for j in range(3):
                    own[i, j] = (half_trace if i == j else 0) - tensor[i, j]
            own[3, 3] = mass
            T = poses[str(link.get("name"))] * _pose(inertial)
            second += T * own * T.T
        mass = second[3, 3]
        centre = [second[k, 3] / mass for k in range(3)]
        central = mpmath.matrix(3, 3)
        for i in range(3):
            for j in range(3):
                central[i, j] = second[i, j] - mass * centre[i] * centre[j]
        trace = central[0, 0] + central[1, 1] + central[2, 2]
        found = np.array(
            [[float((trace if i == j else 0) - central[i, j]) for j in range(3)] for i in range(3)]
        )
        return float(mass), np.array([float(c) for c in centre]), found


def _pose(element: ElementTree.Element) -> mpmath.matrix:
    """Return the homogeneous matrix (4, 4) of an element's <origin>."""
    origin = element.find("origin")
    T = mpmath.eye(4)
    if origin is None:
        return T
    roll, pitch, yaw = (mpmath.mpf(float(word)) for word in origin.get("rpy", "0 0 0").split())
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (mpmath.cos, mpmath.sin))
    R = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    for i, word in enumerate(origin.get("xyz", "0 0 0").split()):
        T[i, 3] = mpmath.mpf(float(word))
        for j in range(3):
            T[i, j] = R[i][j]
    return T
