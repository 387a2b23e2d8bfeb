"""The data of an audit: bodies as stated and as held, their differences, columns of importers.

As plain data it can be read again, for the shards of an audit.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import read_json
from bodycheck.adapters.importers import joint_of
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import principal_axes
from bodycheck.scenarios.model_files.exact_arithmetic import ExactInertia, doubles
from bodycheck.scenarios.model_files.joint import StatedJoint

Severity: TypeAlias = Literal["error", "warning", "note"]
Confidence: TypeAlias = Literal["certain", "likely", "possible"]
State: TypeAlias = Literal["agrees", "rounded", "differs", "merged", "absent", "not computed"]
"""merged: part of another link. not computed: the reader has no truth for this link."""

SAME = 1e-9
"""Relative difference up to which an import in doubles agrees; measured round-off stays below 1e-11."""
SINGLE = 2e-6
"""Relative difference up to which an import agrees as far as single precision can."""

FOLLOWS = "all of it comes from the bodies and joints that differ"
"""The cause of a mass matrix that is right for what an importer holds."""

ALONE = "turns otherwise where it is imported alone, as by damping"
"""What is said of a body whose numbers an importer holds, and which moves as they say in the file."""

_NOTICEABLE = 3.0  # times the error of the engine itself
_FLOOR_RAD = 1e-7  # importers find the principal axes of a nearly symmetric tensor to some 1e-9
_LARGEST = 1e100  # kg, kg m^2: products of larger numbers leave the range of doubles


@dataclass(frozen=True, eq=False)
class Body:
    """Mass in kg, centre of mass (3,) in m and tensor (3, 3) about it in kg m^2, in link axes."""

    mass_kg: float
    centre_m: Array
    inertia_kg_m2: Array

    @classmethod
    def of(cls, exact: ExactInertia) -> Body:
        """Return the nearest doubles of a 40-digit inertia."""
        return cls(float(exact.mass), doubles(exact.centre), doubles(exact.tensor))

    @cached_property
    def principal(self) -> tuple[Array, Array]:
        """Ascending moments (3,) and axes, the columns of (3, 3); NaN where the tensor is not finite."""
        if not np.isfinite(self.inertia_kg_m2).all():
            return np.full(3, np.nan), np.full((3, 3), np.nan)
        if not self.inertia_kg_m2.any():
            return np.zeros(3), np.eye(3)
        return principal_axes(0.5 * self.inertia_kg_m2 + 0.5 * self.inertia_kg_m2.T)

    @property
    def gyration_m(self) -> float:
        """sqrt(tr I / 2 m), the radius of gyration about the centre; 0 without mass."""
        trace = float(np.trace(self.inertia_kg_m2))
        return math.sqrt(trace / (2.0 * self.mass_kg)) if self.mass_kg > 0.0 and trace > 0.0 else 0.0

    @property
    def possible(self) -> bool:
        """Whether a rigid body can have these numbers, to 1e-12, and its motion fits into doubles."""
        first, second, third = map(float, self.principal[0])
        in_range = 0.0 < self.mass_kg <= _LARGEST and first > 0.0 and third <= _LARGEST
        return in_range and first + second >= third * (1.0 - 1e-12)


@dataclass(frozen=True)
class Difference:
    """Held minus stated: |dm| / m, |dc| / max(|c|, radius of gyration), max |dI| / largest moment."""

    mass: float
    centre: float
    inertia: float

    @classmethod
    def between(cls, stated: Body, imported: Body) -> Difference:
        """Return the relative differences; 1 where something is held in place of zero, inf for NaN."""
        length = max(float(np.linalg.norm(stated.centre_m)), stated.gyration_m)
        moment = float(np.max(np.abs(stated.inertia_kg_m2)))
        return cls(
            _relative(abs(imported.mass_kg - stated.mass_kg), abs(stated.mass_kg)),
            _relative(float(np.linalg.norm(imported.centre_m - stated.centre_m)), length),
            _relative(float(np.max(np.abs(imported.inertia_kg_m2 - stated.inertia_kg_m2))), moment),
        )

    @property
    def largest(self) -> float:
        """The largest of the three."""
        return max(self.mass, self.centre, self.inertia)


def _relative(difference: float, scale: float) -> float:
    if not math.isfinite(difference):
        return math.inf
    return difference / scale if scale > 0.0 else float(difference > 0.0)


@dataclass(frozen=True, eq=False)
class LinkImport:
    """One link in one importer: what should be held, what is held, and the named causes of differences.

    expected: the body in the file, or the composite of the links merged into this one. into: the link that
    this one was merged into, "the world" for a fixed base. fixed: whether it is the base of a URDF
    without a link "world", which states no joint to the world, and is fixed to it.
    """

    state: State
    expected: Body | None = None
    held: Body | None = None
    difference: Difference | None = None
    causes: tuple[str, ...] = ()
    merged: tuple[str, ...] = ()
    into: str = ""
    fixed: bool = False


@dataclass(frozen=True)
class ImporterColumn:
    """An importer with its flags: how the import ended, and the settings that the flags mean."""

    engine: str
    version: str
    flags: str
    settings: str
    outcome: str
    message: str = ""

    @property
    def name(self) -> str:
        """ENGINE:FLAGS, or the name of a file."""
        return f"{self.engine}:{self.flags}" if self.flags else self.engine


@dataclass(frozen=True)
class Spin:
    """Orientation errors in rad of one link's free spin against the truth of the body in the file.

    control_rad: the engine with the numbers of the file; held_rad: with the numbers that it held;
    excerpt_rad: after its importer read a file with this link only. None where it could not be spun; the
    message says why.
    """

    control_rad: float | None
    held_rad: float | None
    excerpt_rad: float | None
    message: str = ""

    def follows(self, error_rad: float | None) -> bool | None:
        """Return whether an error is about as small as the engine's own; None where one is not known."""
        if error_rad is None or self.control_rad is None:
            return None
        return error_rad <= _NOTICEABLE * self.control_rad + _FLOOR_RAD

    @property
    def deviates(self) -> bool:
        """Whether the imported link or its excerpt leaves the motion of the file's body."""
        return False in (self.follows(self.held_rad), self.follows(self.excerpt_rad))


@dataclass(frozen=True)
class LintFinding:
    """A finding of the linter: rule, place, what is wrong, what is expected, and how sure that is.

    inertia_kg_m2: xx, xy, xz, yy, yz, zz that are expected, in the axes in which the file states them;
    centre_m: the expected centre of mass in link axes, if another one is expected. shapes_kg_m2: as
    inertia_kg_m2, the tensor of the link's shapes at its mass and uniform density, which need not be the
    right one. None: no such numbers.
    """

    rule: str
    severity: Severity
    confidence: Confidence
    file: str
    line: int
    link: str
    message: str
    expected: str = ""
    inertia_kg_m2: tuple[float, ...] | None = None
    centre_m: tuple[float, ...] | None = None
    shapes_kg_m2: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class LinkAudit:
    """One link: the body in the file, and a comparison and a spin for each importer by its name."""

    name: str
    line: int
    stated: Body | None
    derived: str
    unread: str
    held: Mapping[str, LinkImport]
    spins: Mapping[str, Spin] = field(default_factory=dict)


@dataclass(frozen=True)
class JointComparison:
    """One joint in one importer: what it holds, the named differences, and what it has no number for.

    held: axis and joint point in the axes of the link in the file.
    """

    state: State
    held: StatedJoint | None = None
    causes: tuple[str, ...] = ()
    not_held: tuple[str, ...] = ()


@dataclass(frozen=True)
class JointAudit:
    """One joint: its link, what the file states, and a comparison for each importer by its name."""

    link: str
    stated: StatedJoint
    held: Mapping[str, JointComparison]

    @property
    def name(self) -> str:
        """The name of the joint, or of its link if it has none."""
        return self.stated.name or f"joint of {self.link}"


@dataclass(frozen=True)
class MatrixComparison:
    """The largest |dM_ij| / sqrt(M_ii M_jj) of an importer, the joints of that element, and why it is so.

    deviation None: not compared; then `cause` says why.
    """

    deviation: float | None
    joints: tuple[str, ...] = ()
    cause: str = ""

    @property
    def differs(self) -> bool:
        """Whether it exceeds single precision."""
        return self.deviation is not None and not self.deviation <= SINGLE

    @property
    def is_wrong(self) -> bool:
        """Whether it is not that of the bodies and joints that the importer holds."""
        return self.differs and self.cause != FOLLOWS


@dataclass(frozen=True, eq=False)
class Audit:
    """The audit of one file. outside: files outside of its folder that it names and that were read.

    compared: the file whose bodies, in place of those of importers, are compared with those of `file`.
    matrices: mass matrices by importer; orders: the joints of importers that have them in another order.
    """

    file: str
    format: str
    sha256: str
    columns: Sequence[ImporterColumn]
    links: Sequence[LinkAudit]
    findings: Sequence[LintFinding]
    outside: Sequence[str] = ()
    notes: Sequence[str] = ()
    extra: Mapping[str, Sequence[str]] = field(default_factory=dict)
    compared: str = ""
    joints: Sequence[JointAudit] = ()
    matrices: Mapping[str, MatrixComparison] = field(default_factory=dict)
    orders: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def differing_joints(self) -> list[tuple[JointAudit, str, str]]:
        """Return (joint, importer, cause) of every difference of a joint."""
        return [
            (joint, name, cause)
            for joint in self.joints
            for name, one in joint.held.items()
            for cause in one.causes
        ]

    def differing(self) -> list[tuple[LinkAudit, str, str]]:
        """Return (link, importer, why) of every body that differs, is absent, or moves differently."""
        found = []
        for link in self.links:
            for name, one in link.held.items():
                if one.state in ("differs", "absent"):
                    found.append((link, name, "; ".join(one.causes)))
                elif one.state in ("agrees", "rounded") and name in link.spins and link.spins[name].deviates:
                    if link.spins[name].follows(link.spins[name].held_rad) is not False:
                        found.append((link, name, ALONE))
                    elif one.state == "agrees":
                        found.append((link, name, "the numbers agree, but the motion deviates"))
        return found

    @property
    def failed(self) -> list[str]:
        """The importers that should read the file and did not."""
        return [one.name for one in self.columns if one.outcome not in ("ok", "unsupported")]


AUDIT_FILE = "audit.json"


def write_audit(audit: Audit, folder: Path, **facts: Any) -> None:
    """Write an audit and facts about it to audit.json in a folder."""
    data = {**facts, "audit": asdict(audit)}
    text = json.dumps(data, default=np.ndarray.tolist)
    (folder / AUDIT_FILE).write_text(text + "\n", encoding="utf-8")


def read_audit(folder: Path) -> tuple[Audit, dict[str, Any]]:
    """Read an audit and the facts about it; raises InputError with one line if it cannot be read."""
    path = folder / AUDIT_FILE
    try:
        data = dict(read_json(path))
        return _audit(data.pop("audit")), data
    except FileNotFoundError:
        raise InputError(f"{path}: missing: not a shard of an audit") from None
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a shard of an audit: {error!r}") from None


def _audit(data: Mapping[str, Any]) -> Audit:
    lists = {
        "columns": tuple(ImporterColumn(**one) for one in data["columns"]),
        "links": tuple(map(_link, data["links"])),
        "findings": tuple(LintFinding(**one) for one in data["findings"]),
        "joints": tuple(map(_joint, data["joints"])),
        "matrices": {
            name: MatrixComparison(**{**one, "joints": tuple(one["joints"])})
            for name, one in data["matrices"].items()
        },
    }
    return Audit(**{**data, **lists})


def _link(data: Mapping[str, Any]) -> LinkAudit:
    parts = {
        "stated": _body(data["stated"]),
        "held": {name: _comparison(one) for name, one in data["held"].items()},
        "spins": {name: Spin(**one) for name, one in data["spins"].items()},
    }
    return LinkAudit(**{**data, **parts})


def _joint(data: Mapping[str, Any]) -> JointAudit:
    held = {
        name: JointComparison(
            one["state"],
            None if one["held"] is None else joint_of(one["held"]),
            tuple(one["causes"]),
            tuple(one["not_held"]),
        )
        for name, one in data["held"].items()
    }
    return JointAudit(data["link"], joint_of(data["stated"]), held)


def _comparison(data: Mapping[str, Any]) -> LinkImport:
    difference = data["difference"]
    parts = {
        "expected": _body(data["expected"]),
        "held": _body(data["held"]),
        "difference": None if difference is None else Difference(**difference),
        "causes": tuple(data["causes"]),
        "merged": tuple(data["merged"]),
    }
    return LinkImport(**{**data, **parts})


def _body(data: Mapping[str, Any] | None) -> Body | None:
    if data is None:
        return None
    centre, tensor = (np.array(data[name], dtype=np.float64) for name in ("centre_m", "inertia_kg_m2"))
    if centre.shape != (3,) or tensor.shape != (3, 3):
        raise ValueError(f"a body with a centre of shape {centre.shape} and a tensor of {tensor.shape}")
    return Body(float(data["mass_kg"]), centre, tensor)
