"""Trajectories as files: the columns of the CSV, the arrays of the npz, and a reader of what others wrote."""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bodycheck.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.npz_files import doubles, read_npz

if TYPE_CHECKING:
    import pandas as pd

_ARRAYS = {
    "position_m": ("x_m", "y_m", "z_m"),
    "quaternion": ("qw", "qx", "qy", "qz"),
    "velocity_m_s": ("vx_m_s", "vy_m_s", "vz_m_s"),
    "omega_world_rad_s": ("wx_world_rad_s", "wy_world_rad_s", "wz_world_rad_s"),
    "omega_body_rad_s": ("wx_body_rad_s", "wy_body_rad_s", "wz_body_rad_s"),
    "rotation": tuple(f"r{i}{j}" for i in range(3) for j in range(3)),
}
"""Array of the npz -> its columns in the CSV."""

_IGNORED = ("bound_rad",)  # the last column of `bodycheck truth`


def trajectory_table(trajectory: Trajectory) -> pd.DataFrame:
    """Return t_s, x_m, ..., qw, ..., wz_body_rad_s, one row a sample; omega in both axes."""
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
        columns |= {name: value[:, i] for i, name in enumerate(_ARRAYS[array])}
    return pd.DataFrame(columns)


def stored_arrays(trajectory: Trajectory) -> dict[str, Array]:
    """Return the arrays that the npz of a trajectory holds."""
    values = {name: getattr(trajectory, name) for name in ("t_s", *_ARRAYS)}
    return {name: value for name, value in values.items() if value is not None}


def npz(arrays: Mapping[str, Array]) -> bytes:
    """Return the bytes of the .npz file that np.load reads these arrays from; equal for equal arrays.

    numpy.savez seeks and writes a dozen times for each array; in memory the whole is one stroke.
    """
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        for name, array in arrays.items():
            doubles = np.ascontiguousarray(array, dtype="<f8")
            # with a date of its own, the earliest that zip has, not that of the run
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), _npy_header(doubles.shape) + doubles.tobytes())
    return whole.getvalue()


@lru_cache
def _npy_header(shape: tuple[int, ...]) -> bytes:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return header.getvalue()


def read_arrays(path: Path) -> dict[str, Array]:
    """Read t_s (n,) and any of the arrays of a trajectory, (n, 3), (n, 4) or (n, 3, 3), from .csv or .npz.

    Raises InputError with one line that names the file and what is wrong with it.
    """
    try:
        arrays = read_npz(path, ("t_s", *_ARRAYS)) if path.suffix == ".npz" else _read_csv(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    t_s = arrays.get("t_s")
    if t_s is None:
        raise InputError(f"{path}: has no t_s")
    if t_s.ndim != 1 or not len(t_s) or not np.all(np.isfinite(t_s)) or np.any(np.diff(t_s) <= 0.0):
        raise InputError(f"{path}: t_s must be finite times in ascending order")
    if len(arrays) == 1:
        raise InputError(f"{path}: has no quantity beside t_s; known are {', '.join(_ARRAYS)}")
    for name, value in arrays.items():
        shape = {"t_s": (), "rotation": (3, 3)}.get(name, (len(_ARRAYS.get(name, ())),))
        if value.shape != (len(t_s), *shape):
            raise InputError(f"{path}: {name} has the shape {value.shape}, not {(len(t_s), *shape)}")
    return arrays


def _read_csv(path: Path) -> dict[str, Array]:
    import pandas as pd

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # a row of the wrong width
            table = pd.read_csv(
                path,
                skipinitialspace=True,
                index_col=False,
                keep_default_na=False,
                na_values=["nan", "NaN"],
                compression=None,  # never guessed from the file's name
            )
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
        raise InputError(f"{path}: is not CSV: {' '.join(str(error).split())}") from None
    known = {"t_s", *_IGNORED, *(column for columns in _ARRAYS.values() for column in columns)}
    if unknown := [str(column) for column in table.columns if column not in known]:
        raise InputError(f"{path}: no column of a trajectory is named {', '.join(unknown)}")
    if table.empty:
        raise InputError(f"{path}: has no rows")
    for column in table.columns:
        kind = table[column].dtype.kind
        if kind == "b":
            raise InputError(f"{path}: {column} holds truth values, not numbers")
        if kind not in "fiu":
            row = int(np.argmax(pd.to_numeric(table[column], errors="coerce").isna().to_numpy()))
            found = table[column].iloc[row]
            raise InputError(f"{path}: line {row + 2}: {column} is {found!r}, not a number")
    try:
        values = {str(column): doubles(table[column].to_numpy(), str(column)) for column in table.columns}
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    arrays: dict[str, Array] = {"t_s": values["t_s"]} if "t_s" in values else {}
    for array, columns in _ARRAYS.items():
        there = [column for column in columns if column in table]
        if there and len(there) < len(columns):
            missing = ", ".join(column for column in columns if column not in table)
            raise InputError(f"{path}: has {there[0]} but not {missing}")
        if there:
            together = np.stack([values[column] for column in there], axis=-1)
            arrays[array] = together.reshape(-1, 3, 3) if array == "rotation" else together
    return arrays
