"""Trajectory files: numpy reads what was written, bit for bit."""

from __future__ import annotations

import io
import zipfile

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.trajectory_files import npz


def arrays_of(n: int) -> dict[str, Array]:
    """Return arrays of every shape that a trajectory has, with numbers that are not ordinary among them."""
    dice = np.random.default_rng(7)
    arrays = {"t_s": dice.random(n), "quaternion": dice.random((n, 4)), "rotation": dice.random((n, 3, 3))}
    arrays["position_m"] = np.array([[np.nan, -0.0, 5e-324]] * n)
    arrays["velocity_m_s"] = np.asfortranarray(dice.random((n, 3)))
    return arrays


def test_npz_is_read_by_numpy_bit_for_bit() -> None:
    """Names, shapes and values come back without pickles."""
    arrays = arrays_of(101)
    written = npz(arrays)
    assert zipfile.ZipFile(io.BytesIO(written)).testzip() is None
    with np.load(io.BytesIO(written), allow_pickle=False) as read:
        assert read.files == list(arrays)
        for name, array in arrays.items():
            assert read[name].shape == array.shape
            assert read[name].tobytes() == array.tobytes()
            assert read[name].dtype == np.float64


def test_equal_arrays_make_equal_files() -> None:
    """The file has no date, so two runs can be compared byte by byte."""
    assert npz(arrays_of(3)) == npz(arrays_of(3))
    assert b"\x00\x00!\x00" in npz(arrays_of(3))[:16]  # midnight of the first of January 1980
