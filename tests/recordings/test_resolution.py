"""The resolution of a recording, from the digits, the types and the stamps of its columns."""

from __future__ import annotations

import json
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bodycheck.recordings.column_map import read_map
from bodycheck.recordings.conversion import RecordedMotion, recorded_motion
from bodycheck.recordings.resolution import digits_of, since_first, stamp_spacing, written_digits
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.tables import as_parquet

RATES = ("wx_body_rad_s", "wy_body_rad_s", "wz_body_rad_s")


def rates(rows: int = 200) -> Array:
    """Return angular velocities (rows, 3) below 4 rad/s."""
    t_s = 0.01 * np.arange(rows)
    return np.stack([3.1 * np.sin(t_s), 0.7 * np.cos(3.0 * t_s), 2.0 + 0.3 * np.sin(5.0 * t_s)], axis=-1)


def written(folder: Path, write: Callable[[float], str], values: Array, spec: str = "") -> RecordedMotion:
    """Return what is read of a CSV whose numbers are written by a function."""
    rows = ["t_s," + ",".join(RATES)]
    rows += [f"{k / 100:.2f}," + ",".join(map(write, row)) for k, row in enumerate(values.tolist())]
    path = folder / "log.csv"
    path.write_text("\n".join(rows) + "\n")
    return recorded_motion(path, read_map([spec] if spec else ()))


WRITTEN: dict[str, tuple[Callable[[float], str], list[float]]] = {
    "six decimals": (lambda v: f"{v:.6f}", [1e-6] * 3),
    "six decimals, zeros stripped": (lambda v: repr(round(v, 6)), [1e-6] * 3),
    "two decimals": (lambda v: f"{v:.2f}", [1e-2] * 3),
    "nine digits": (lambda v: f"{v:.9g}", [1e-8, 1e-9, 1e-8]),
    "four digits with exponent": (lambda v: f"{v:.3e}", [1e-3, 1e-4, 1e-3]),
    "doubles in full": (lambda v: f"{v:.17g}", [2**-51, 2**-53, 2**-51]),
    "shortest doubles": (repr, [2**-51, 2**-53, 2**-51]),
    "shortest float32": (lambda v: str(np.float32(v)), [2**-22, 2**-24, 2**-22]),
    "float32 in nine digits": (lambda v: f"{np.float32(v):.9g}", [2**-22, 2**-24, 2**-22]),
}


@pytest.mark.parametrize("kind", WRITTEN)
def test_digits_of_a_csv_give_its_resolution(kind: str, tmp_path: Path) -> None:
    """Fixed decimals, significant digits and float32 are distinguished by the numbers alone."""
    write, expected = WRITTEN[kind]
    found = written(tmp_path, write, rates()).resolution["omega_body_rad_s"]
    shortest = kind in ("shortest doubles", "doubles in full")
    np.testing.assert_allclose(found, expected, rtol=9.0 if shortest else 1e-12)  # 17 digits or 53 bits
    assert np.all(found >= np.array(expected) * (1 - 1e-12))


@pytest.mark.parametrize("digits", [2, 4, 6, 8, 10])
def test_resolution_is_that_of_the_rounding(digits: int, tmp_path: Path) -> None:
    """No number moves by more than half of the resolution, and some move by nearly as much."""
    rng = np.random.default_rng(digits)
    values = rng.normal(size=(300, 3)) * 10.0 ** rng.integers(-2, 4)
    for write in (lambda v: f"{v:.{digits}g}", lambda v: f"{v:.{digits}f}"):
        motion = written(tmp_path, write, values)
        moved = np.max(np.abs(motion.arrays["omega_body_rad_s"] - values), axis=0)
        resolution = motion.resolution["omega_body_rad_s"]
        assert np.all(moved <= 0.5 * resolution * (1.0 + 1e-6))
        assert np.all(moved >= 0.3 * resolution)


@pytest.mark.parametrize("kind", ["npz", "parquet", "jsonl"])
@pytest.mark.parametrize("width", ["float32", "float64", "six decimals"])
def test_binary_formats_have_the_resolution_of_their_numbers(kind: str, width: str, tmp_path: Path) -> None:
    """float32 is found in doubles too, and so are numbers that were rounded before they were stored."""
    values = rates().round(6) if width == "six decimals" else rates().astype(width)
    columns: dict[str, Any] = {"t_s": 0.01 * np.arange(200)} | dict(zip(RATES, values.T, strict=True))
    path = tmp_path / f"log.{kind}"
    if kind == "npz":
        np.savez(path, **columns)
    elif kind == "parquet":
        path.write_bytes(as_parquet(pd.DataFrame(columns)))
    else:
        table = pd.DataFrame({name: np.asarray(column, float) for name, column in columns.items()})
        path.write_text("".join(json.dumps(row) + "\n" for row in table.to_dict("records")))
    expected = {"float32": [2**-22, 2**-24, 2**-22], "float64": [2**-51, 2**-53, 2**-51]}
    found = recorded_motion(path, read_map(())).resolution["omega_body_rad_s"]
    ratio = found / np.array(expected.get(width, [1e-6] * 3))
    assert np.all((ratio > 1 - 1e-12) & (ratio < 10.0 if width == "float64" else ratio < 1 + 1e-12))


def test_constant_columns_have_the_digits_of_the_others(tmp_path: Path) -> None:
    """A rate of exactly 2 rad/s in a log of doubles is not rounded to whole numbers."""
    values = rates()
    values[:, 2], values[:, 1] = 2.0, 0.0
    assert written(tmp_path, repr, values).resolution["omega_body_rad_s"][2] < 1e-14
    spins = np.tile([0.0, 0.0, 2.0], (50, 1))
    assert np.max(written(tmp_path, repr, spins).resolution["omega_body_rad_s"]) < 1e-14
    assert (
        written(tmp_path, lambda v: f"{v:.4f}", values).resolution["omega_body_rad_s"].tolist() == [1e-4] * 3
    )


def test_equal_steps_do_not_show_how_they_were_rounded(tmp_path: Path) -> None:
    """A rate under a constant torque may have few digits in a log of many, as a constant one has."""
    values = rates()
    values[:, 2] = 0.5 + 0.25 * np.arange(len(values))
    assert (
        written(tmp_path, lambda v: f"{v:.9f}", values).resolution["omega_body_rad_s"].tolist() == [1e-9] * 3
    )
    assert digits_of(4.0 - 0.981 * np.arange(200)) is None


@pytest.mark.parametrize("decimals", [1, 2, 3])
def test_a_slow_quantity_shows_how_it_was_rounded(decimals: int, tmp_path: Path) -> None:
    """Most of its values equal the one before, and the others differ by one unit of the last decimal."""
    values = 3.0 * 0.1**decimals * rates(2000)
    assert np.mean(np.diff(values.round(decimals), axis=0) == 0.0) > 0.9
    motion = written(tmp_path, lambda v: f"{v:.{decimals}f}", values)
    assert motion.resolution["omega_body_rad_s"] == pytest.approx([0.1**decimals] * 3)


@pytest.mark.parametrize("decimals", [2, 3, 6])
def test_final_zeros_show_how_a_constant_was_rounded(decimals: int, tmp_path: Path) -> None:
    """0.00 beside 0.31 has two decimals, but nothing shows how 0.0 or 0.31 alone was rounded."""
    spin = np.tile([0.0, 0.0, 0.3125], (50, 1))
    motion = written(tmp_path, lambda v: f"{v:.{decimals}f}", spin)
    assert motion.resolution["omega_body_rad_s"] == pytest.approx([0.1**decimals] * 3)
    assert np.max(written(tmp_path, repr, spin).resolution["omega_body_rad_s"]) < 1e-14
    assert written_digits(["0.31", "0.31"]) is None
    assert written_digits(["0.30", "0.3"]) is None
    assert written_digits(["0.0", "2.0"]) is None


def test_jumps_of_a_held_quantity_do_not_show_how_it_was_rounded() -> None:
    """Other jumps than by one unit are those of the quantity: 0.1, then 0.3, then 0.6."""
    assert digits_of(np.repeat([0.1, 0.3, 0.6], 50)) is None
    assert digits_of(np.repeat([0.1, 0.2, 0.3], 50)) is not None


def test_resolution_is_mapped_like_its_column(tmp_path: Path) -> None:
    """Units, products and axes apply to the resolution, and angles give that of the quaternion."""
    rows = ["t,p,q,r,yaw,pitch,roll"]
    rows += [
        f"{k},{k * k % 7},{k % 5},{k % 3},{k * k % 9 * 0.1:.1f},{k % 9 / 100:.2f},{k % 8}" for k in range(40)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(rows) + "\n")
    spec = (
        "t_s=t, wx_body_rad_s=p*2*deg, wy_body_rad_s=q*deg, wz_body_rad_s=-r*0.5*deg, body=FRD to FLU, "
        "euler_1_rad=yaw*deg, euler_2_rad=pitch*deg, euler_3_rad=roll*deg, euler=ZYX"
    )
    found = recorded_motion(path, read_map([spec])).resolution
    np.testing.assert_allclose(found["omega_body_rad_s"], np.deg2rad([2.0, 1.0, 0.5]), rtol=1e-12)
    np.testing.assert_allclose(found["quaternion"], np.full(4, 0.5 * np.deg2rad(1.11)), rtol=1e-12)
    assert found["t_s"] == 0.0


def test_digits_of_too_few_values_are_unknown() -> None:
    """Two values do not show how they were rounded."""
    assert digits_of(np.array([0.0, 1.0, 0.0, 1.0])) is None
    assert digits_of(np.array([0.0, 0.25, 1.0])) is not None


STAMPS: dict[str, tuple[list[int | str], float]] = {
    "even": (["0", "0.1", "0.2", "0.3"], 0.0),
    "coarser than the digits": (["0", "0.25", "1.0", "1.75"], 0.0),
    "thirtieths of a second": (["0", "0.033", "0.067", "0.1"], 1e-3),
    "jitter in nanoseconds": ([0, 100000017, 200000004], 1.0),
    "even nanoseconds since 1970": ([1403715524907143168, 1403715525007143168, 1403715525107143168], 0.0),
}


@pytest.mark.parametrize("kind", STAMPS)
def test_stamps_are_exact_unless_they_are_rounded(kind: str) -> None:
    """Even stamps are the times that they stand for; uneven ones are rounded to their last digit."""
    stamps, expected = STAMPS[kind]
    exact = [stamp if isinstance(stamp, int) else Decimal(stamp) for stamp in stamps]
    assert stamp_spacing(exact) == expected
    differences = [float(Fraction(stamp) - Fraction(exact[0])) for stamp in exact]
    assert since_first(exact).tolist() == differences


def test_a_round_number_above_the_others_does_not_coarsen_them() -> None:
    """A quaternion that starts at 1 and has six decimals has six decimals, not six digits of 1."""
    values = np.r_[1.0, np.round(np.cos(np.linspace(0.01, 1.0, 50)), 6)]
    digits = digits_of(values)
    assert digits is not None
    assert digits.spacing(1.0) == pytest.approx(1e-6)
