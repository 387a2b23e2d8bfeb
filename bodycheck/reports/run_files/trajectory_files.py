"""The quantities of a trajectory: their columns in a table, and their arrays in an npz."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias, cast

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number, unread
from bodycheck._util.untrusted import open_input
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.joint_kind import Translation
from bodycheck.reference_impl.trees.tree_scene import TreeBody, TreeScene

if TYPE_CHECKING:
    import pandas as pd

MAX_BYTES = 1 << 28
"""Limit for all arrays together, as doubles; the quantities of a million samples take 208 MB."""
_ALWAYS_BYTES = 1 << 25
_MAX_PACKED = 50  # above that, times the file size: denser files are zip bombs, or a body at rest
_DOUBLE_BYTES = 8
_MAX_DIMENSIONS = 4  # of the rotations of a tree
_EXACT = 2**53  # every integer up to here is a double
_ENCRYPTED = 0x1
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what numpy writes

Stored: TypeAlias = np.ndarray[Any, np.dtype[Any]]
"""An array of real numbers in the type of its file."""


def read_npz(
    path: Path, names: Sequence[str] | None = None, faults: dict[str, str] | None = None
) -> dict[str, Stored]:
    """Return those of the named arrays that the file has, in their own types; of all arrays without names.

    faults: receives name -> message for an array that is not of real numbers, and is left out. Raises OSError
    where the file cannot be read, and InputError with one line where it is not an npz of real numbers.
    """
    try:
        with open_input(path) as file, zipfile.ZipFile(file) as archive:
            left = min(MAX_BYTES, max(_ALWAYS_BYTES, _MAX_PACKED * path.stat().st_size))
            present = [name.removesuffix(".npy") for name in archive.NameToInfo if name.endswith(".npy")]
            arrays = {}
            for name in present if names is None else [name for name in names if name in present]:
                try:
                    arrays[name] = _array(archive, name, left)
                except ValueError as error:
                    if faults is None:
                        raise
                    faults[name] = str(error)
                else:
                    left -= arrays[name].size * _DOUBLE_BYTES
            return arrays
    except (ValueError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: not an npz file of numbers: {' '.join(str(error).split())}") from None


def _array(archive: zipfile.ZipFile, name: str, max_bytes: int) -> Stored:
    """Return one member, of at most `max_bytes` bytes as doubles, in the byte order of this machine.

    Raises ValueError where its header and its size disagree, or its type is not real.
    """
    member = archive.getinfo(f"{name}.npy")
    if member.flag_bits & _ENCRYPTED:
        raise ValueError(f"{name} is encrypted")
    if member.compress_type not in _METHODS:
        raise ValueError(f"{name} has an unsupported compression; use numpy.savez or numpy.savez_compressed")
    with archive.open(member) as packed:
        stream = cast(BinaryIO, packed)
        shape, columns_first, dtype = _header(stream, name, max_bytes)
        size = math.prod(shape) * dtype.itemsize
        content = stream.read(size + 1)
    if len(content) != size:
        raise ValueError(f"{name} has the shape {shape} of {dtype}, but {len(content)} bytes, not {size}")
    values = np.frombuffer(content, dtype).reshape(shape, order="F" if columns_first else "C")
    return np.ascontiguousarray(values, dtype=dtype.newbyteorder("="))


def _header(stream: BinaryIO, name: str, max_bytes: int) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, order and type of a numeric array of at most `max_bytes` bytes as doubles."""
    version = np.lib.format.read_magic(stream)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read is None:
        raise ValueError(f"{name} has the unsupported npy version {version}")
    try:
        shape, columns_first, dtype = read(stream)
    except Exception as error:  # noqa: BLE001 - a literal of Python, whose parser raises many errors
        raise ValueError(f"{name} has a header that cannot be read: {type(error).__name__}") from None
    if dtype.kind not in "fiu":
        raise ValueError(f"{name} has type {dtype}, not real numbers")
    if dtype.itemsize > _DOUBLE_BYTES:
        raise ValueError(f"{name} has type {dtype}, which does not fit in doubles")
    if len(shape) > _MAX_DIMENSIONS or min(shape, default=0) < 0:
        raise ValueError(f"{name} has the shape {shape}")
    if math.prod(shape) * _DOUBLE_BYTES > max_bytes:
        raise ValueError(f"{name} declares the shape {shape}, which exceeds the limit of {max_bytes} bytes")
    return shape, columns_first, dtype


def doubles(values: Stored, name: str) -> Array:
    """Return real numbers as doubles; raise ValueError for integers above 2^53."""
    is_integer = values.dtype.kind in "iu" and values.size
    if is_integer and max(int(values.max()), -int(values.min())) > _EXACT:
        raise ValueError(f"{name} has integers above 2^53, which do not fit in doubles")
    return values.astype(np.float64)


COLUMNS = {
    "position_m": ("x_m", "y_m", "z_m"),
    "quaternion": ("qw", "qx", "qy", "qz"),
    "velocity_m_s": ("vx_m_s", "vy_m_s", "vz_m_s"),
    "omega_world_rad_s": ("wx_world_rad_s", "wy_world_rad_s", "wz_world_rad_s"),
    "omega_body_rad_s": ("wx_body_rad_s", "wy_body_rad_s", "wz_body_rad_s"),
    "rotation": tuple(f"r{i}{j}" for i in range(3) for j in range(3)),
}
"""Array of the npz -> its columns in the CSV."""
SENSORS = {
    "specific_force_m_s2": ("ax_m_s2", "ay_m_s2", "az_m_s2"),
    "gyro_rad_s": ("gx_rad_s", "gy_rad_s", "gz_rad_s"),
}
"""Array of the npz that an engine's sensors read -> its columns."""

_ARRAYS = {**COLUMNS, **SENSORS}

_OF_TREES = ("q", "u")
"""Arrays of a tree; its others have an axis for bodies after that of samples."""


def trajectory_table(trajectory: Trajectory) -> pd.DataFrame:
    """Return t_s, x_m, ..., qw, ..., wz_body_rad_s, one row per sample; omega in both axes."""
    import pandas as pd

    values = {
        "position_m": trajectory.position_m,
        "quaternion": trajectory.attitude,
        "velocity_m_s": trajectory.velocity_m_s,
        "omega_world_rad_s": trajectory.omega_world,
        "omega_body_rad_s": trajectory.omega_body,
    }
    columns = {"t_s": trajectory.t_s}
    for array, value in values.items():
        columns |= {name: value[:, i] for i, name in enumerate(COLUMNS[array])}
    return pd.DataFrame(columns)


def state_columns(body: TreeBody) -> tuple[list[str], list[str]]:
    """Return the names of the coordinates and rates of a body's joint, of a free one those of its motion."""
    kind = body.joint.of_kind
    if kind.translation is Translation.SPACE:
        head = f"body.{body.name}."
        places = [*COLUMNS["position_m"], *COLUMNS["quaternion"]]
        rates = [*COLUMNS["velocity_m_s"], *COLUMNS["omega_body_rad_s"]]
    else:
        head = f"joint.{body.name}."
        places = [*["q_m"] * bool(kind.translation), *((), ("q_rad",), COLUMNS["quaternion"])[kind.rotation]]
        rates = ["rate"] if kind.rates == 1 else ["rate_x", "rate_y", "rate_z"]
    return [head + name for name in places], [head + name for name in rates]


def tree_table(scene: TreeScene, trajectory: Trajectory) -> pd.DataFrame:
    """Return t_s, body.NAME.x_m ... of each body, joint.NAME.q_rad, q_m or qw ..., and joint.NAME.rate."""
    import pandas as pd

    assert trajectory.q is not None
    assert trajectory.u is not None
    columns: dict[str, Array] = {"t_s": trajectory.t_s}
    for k, body in enumerate(scene.bodies):
        own = Trajectory(
            trajectory.t_s,
            trajectory.position_m[:, k],
            trajectory.velocity_m_s[:, k],
            trajectory.attitude[:, k],
            omega_body_rad_s=trajectory.omega_body[:, k],
        )
        table = trajectory_table(own)
        columns |= {f"body.{body.name}.{name}": table[name].to_numpy() for name in table.columns[1:]}
    for body, places, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        if body.joint.of_kind.translation is Translation.SPACE:
            continue
        names, speeds = state_columns(body)
        for joint, values in ((names, trajectory.q[:, places]), (speeds, trajectory.u[:, rates])):
            columns |= {name: values[:, i] for i, name in enumerate(joint)}
    return pd.DataFrame(columns)


def stored_arrays(trajectory: Trajectory) -> dict[str, Array]:
    """Return the arrays that the npz of a trajectory holds."""
    values = {name: getattr(trajectory, name) for name in ("t_s", *_ARRAYS, *_OF_TREES)}
    return {name: value for name, value in values.items() if value is not None}


def npz(arrays: Mapping[str, Array]) -> bytes:
    """Return an .npz file as bytes, readable by np.load; equal arrays give equal bytes.

    It is built in memory, because numpy.savez seeks and writes a dozen times per array.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            doubles = np.ascontiguousarray(array, dtype="<f8")
            # ZipInfo defaults to the earliest zip date, so the bytes do not depend on the time of the run
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), _npy_header(doubles.shape) + doubles.tobytes())
    return buffer.getvalue()


@lru_cache
def _npy_header(shape: tuple[int, ...]) -> bytes:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return header.getvalue()


def read_arrays(path: Path) -> dict[str, Array]:
    """Read t_s (n,) and any arrays of a trajectory, (n, 3), (n, 4) or (n, 3, 3), or of a tree, from .npz.

    Raises InputError with one line that names the file and the fault.
    """
    try:
        stored = read_npz(path, ("t_s", *_ARRAYS, *_OF_TREES))
    except OSError as error:
        raise InputError(unread(path, error)) from None
    try:
        arrays = {name: doubles(array, name) for name, array in stored.items()}
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return checked_arrays(path, arrays, trees=True)


def checked_arrays(path: Path, arrays: dict[str, Array], *, trees: bool = False) -> dict[str, Array]:
    """Return the arrays of a trajectory; trees: it may be of one.

    Raises InputError if the times are not ascending, or if a quantity is missing or of another shape.
    """
    t_s = arrays.get("t_s")
    if t_s is None:
        raise InputError(f"{path}: has no t_s")
    if t_s.ndim != 1 or not len(t_s) or not np.all(np.isfinite(t_s)):
        raise InputError(f"{path}: t_s must be finite times in ascending order")
    if len(back := np.flatnonzero(np.diff(t_s) <= 0.0)):
        before, after = (number(float(time)) for time in t_s[back[0] : back[0] + 2])
        later = f"sample {back[0] + 2} is at {after} s, the one before at {before} s"
        raise InputError(f"{path}: t_s must be finite times in ascending order, but {later}")
    if len(arrays) == 1:
        raise InputError(f"{path}: has no quantity besides t_s (available: {', '.join(COLUMNS)})")
    of_tree = trees and any(name in arrays for name in _OF_TREES)
    bodies = arrays["position_m"].shape[1:2] if of_tree and "position_m" in arrays else ()
    for name, value in arrays.items():
        if name in _OF_TREES and value.ndim == 2 and len(value) == len(t_s):
            continue
        shape = {"t_s": (), "rotation": (3, 3)}.get(name, (len(_ARRAYS.get(name, ())),))
        shape = shape if name == "t_s" else (*bodies, *shape)
        if value.shape != (len(t_s), *shape):
            raise InputError(f"{path}: {name} has the shape {value.shape}, not {(len(t_s), *shape)}")
    return arrays
