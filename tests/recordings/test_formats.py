"""Formats of recordings: the same motion is read alike from every layout, stamp and message that is known."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import bodycheck
from bodycheck.recordings.column_map import read_map
from bodycheck.recordings.conversion import recorded_motion
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.tables import as_parquet
from tests.helpers.expected_messages import ExpectedMessage

CASES = Path(__file__).parent / "cases"
SCENARIO = "symmetric-top"
STEP_NS = 100_000_000
EPOCH_NS = 1_403_715_524_907_143_168
QUATERNION = ("qw", "qx", "qy", "qz")
RATES = ("wx_body_rad_s", "wy_body_rad_s", "wz_body_rad_s")


def judged(path: Path, spec: str = "", like: str | None = None) -> dict[str, Any]:
    """Return the measures of a file."""
    return bodycheck.judge(path, SCENARIO, column_map=spec or (), like=like)


def turned() -> tuple[Array, Array, Array]:
    """Return times (n,), and quaternions (n, 4) and rates (n, 3) that are off the truth by a twentieth."""
    t_s = np.arange(12) * 0.1
    true = bodycheck.truth(SCENARIO, list(t_s)).trajectory
    rng = np.random.default_rng(41)
    off = Rotation.from_rotvec(0.05 * rng.normal(size=(12, 3)))
    quaternion = (off * Rotation.from_quat(true.attitude, scalar_first=True)).as_quat(scalar_first=True)
    return t_s, quaternion, true.omega_body + 0.05 * rng.normal(size=(12, 3))


def expected(tmp_path: Path) -> dict[str, Any]:
    """Return the measures of the motion in bodycheck's own columns."""
    t_s, quaternion, omega = turned()
    path = tmp_path / "own.npz"
    np.savez(path, t_s=t_s, quaternion=quaternion, omega_body_rad_s=omega)
    return judged(path)


def assert_same(found: dict[str, Any], other: dict[str, Any], absolute: float = 1e-14) -> None:
    """Compare all measures that both have, but for the norm of a quaternion that one of them lacks."""
    shared = {name for name in found if isinstance(found[name], float)} & set(other)
    shared -= {"quaternion_norm_error", "truth_bound_rad"}
    assert "orientation_error_rad" in shared
    for name in shared:
        assert found[name] == pytest.approx(other[name], rel=3e-14, abs=absolute), name


# ------------------------------------------------------------------------------------------------- stamps


def test_stamps_since_1970_are_read_without_loss() -> None:
    """Nanoseconds and microseconds since 1970 are as accurate as relative ones."""
    for name, unit in (("ns", "ns"), ("us", "us"), ("relative_us", "us")):
        spec = f"t_s=stamp*{unit}, time_origin=first-sample"
        assert judged(CASES / f"{name}.csv", spec)["orientation_error_rad"] < 1e-14


def as_seconds(ns: int, digits: int = 9) -> str:
    """Return a stamp in s as decimal text."""
    return f"{Decimal(ns).scaleb(-9):.{digits}f}"


STAMPS: dict[str, tuple[Callable[[int], Any], str]] = {
    "nanoseconds since 1970": (lambda ns: ns, "t_s=stamp*ns"),
    "microseconds since 1970": (lambda ns: ns // 1000, "t_s=stamp*us"),
    "relative nanoseconds": (lambda ns: ns - EPOCH_NS, "t_s=stamp*ns"),
    "decimal seconds since 1970": (as_seconds, "t_s=stamp"),
    "relative decimal seconds": (lambda ns: as_seconds(ns - EPOCH_NS), "t_s=stamp"),
    "dates": (lambda ns: f"{np.datetime64(ns, 'ns')}Z", "t_s=stamp"),
}


def write_stamped(kind: str, stamps: list[Any], path: Path) -> Path:
    """Write stamps and the quaternion in one format; stamps are integers, decimal text, or floats."""
    _, quaternion, _ = turned()
    path = path.with_suffix(f".{kind}")
    columns = dict(zip(QUATERNION, quaternion.T, strict=True))
    if kind == "npz":
        np.savez(path, stamp=np.array(stamps), **columns)
    elif kind == "parquet":
        path.write_bytes(as_parquet(pd.DataFrame({"stamp": stamps} | columns)))
    elif kind == "jsonl":
        rows = pd.DataFrame(columns).to_dict("records")
        texts = [stamp if isinstance(stamp, str) else json.dumps(stamp) for stamp in stamps]
        texts = [json.dumps(text) if "T" in text else text for text in texts]
        lines = (f'{{"stamp": {text}, {json.dumps(row)[1:]}\n' for text, row in zip(texts, rows, strict=True))
        path.write_text("".join(lines))
    else:
        pd.DataFrame({"stamp": stamps} | columns).to_csv(path, index=False)
    return path


@pytest.mark.slow(after=4)
@pytest.mark.nightly(after=13)
@pytest.mark.parametrize("how", STAMPS)
@pytest.mark.parametrize("kind", ["csv", "npz", "parquet", "jsonl"])
def test_exact_stamps_give_the_same_figures(kind: str, how: str, tmp_path: Path) -> None:
    """Integers and decimal text give the same figures to 1e-14, whatever they count from."""
    stamp, spec = STAMPS[how]
    stamps = [stamp(EPOCH_NS + k * STEP_NS) for k in range(12)]
    if kind == "npz" and isinstance(stamps[0], str):
        pytest.skip("an npz has no text")
    path = write_stamped(kind, stamps, tmp_path / "log")
    found = judged(path, f"{spec}, time_origin=first-sample")
    assert "stamp_spacing_s" not in found
    assert_same(found, expected(tmp_path))


def test_dates_in_parquet_are_read_to_the_nanosecond(tmp_path: Path) -> None:
    """A column of dates is a column of times."""
    dates = pd.to_datetime([EPOCH_NS + k * STEP_NS for k in range(12)])
    path = write_stamped("parquet", list(dates), tmp_path / "log")
    assert_same(judged(path, "t_s=stamp, time_origin=first-sample"), expected(tmp_path))


@pytest.mark.parametrize("kind", ["npz", "parquet"])
def test_float_stamps_are_within_the_bound_of_their_spacing(kind: str, tmp_path: Path) -> None:
    """Doubles since 1970 are 2.4e-7 s apart: the spacing is stated, and the bound includes it."""
    rng = np.random.default_rng(7)
    steps = STEP_NS * np.arange(12) + rng.integers(-1000, 1000, 12)
    steps[0] = 0
    true = bodycheck.truth(SCENARIO, list(steps * 1e-9)).trajectory
    stamps = [(EPOCH_NS + int(step)) / 10**9 for step in steps]
    path = tmp_path / f"log.{kind}"
    columns = {"stamp": stamps} | dict(zip(QUATERNION, true.attitude.T, strict=True))
    if kind == "npz":
        np.savez(path, **columns)
    else:
        path.write_bytes(as_parquet(pd.DataFrame(columns)))
    found = judged(path, "t_s=stamp, time_origin=first-sample")
    assert found["stamp_spacing_s"] == 2.0**-22
    assert 1e-8 < found["orientation_error_rad"] < found["truth_bound_rad"] < 1e-6


def test_integers_above_2_53_need_the_first_subtracted(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The message names the option with which they are read."""
    shutil.copy(CASES / "ns.csv", tmp_path)
    with expected_message.raises(bodycheck.InputError):
        judged(tmp_path / "ns.csv", "t_s=stamp*ns")


# ------------------------------------------------------------------------------------------ layouts of text

HEADER = ("t_s", *QUATERNION, *RATES)


def write_text(path: Path, layout: str) -> Path:
    """Write the motion as text."""
    t_s, quaternion, omega = turned()
    rows = [[repr(float(v)) for v in row] for row in np.column_stack([t_s, quaternion, omega])]
    blank = layout in ("blanks", "comments and no header")
    separator = {"semicolons": ";", "decimal commas": ";", "tabs": "\t"}.get(layout, " " if blank else ",")
    lines = [separator.join(row) for row in [list(HEADER), *rows]]
    if layout == "decimal commas":
        lines = [line.replace(".", ",") for line in lines]
    if layout == "a byte order mark":
        lines[0] = "\ufeff" + lines[0]
    if layout == "comments":
        lines = ["# a log", "% of text", "", *lines[:4], "# in the middle", "", *lines[4:]]
    if layout == "comments and no header":
        lines = ["# a log", "# " + lines[0], *lines[1:]]
    path.write_text("\n".join(lines) + "\n", encoding="utf-16" if layout == "UTF-16" else "utf-8")
    return path


LAYOUTS = (
    *("commas", "semicolons", "decimal commas", "tabs", "blanks", "comments", "comments and no header"),
    *("a byte order mark", "UTF-16"),
)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("suffix", [".csv", ".txt", ".log", ""])
def test_tables_of_text_are_read_in_every_layout(layout: str, suffix: str, tmp_path: Path) -> None:
    """Separators, comments, a missing header and the suffix change nothing."""
    assert_same(judged(write_text(tmp_path / f"log{suffix}", layout)), expected(tmp_path))


def test_columns_without_a_header_have_numbers(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """They are named by a map, as c1, c2, ... or all at once."""
    t_s, quaternion, omega = turned()
    path = tmp_path / "log.txt"
    np.savetxt(path, np.column_stack([t_s, quaternion, omega]), fmt="%.17g")
    with expected_message.raises(bodycheck.InputError):
        judged(path)
    for spec in (
        "t_s=c1, qw=c2, qx=c3, qy=c4, qz=c5, wx_body_rad_s=c6, wy_body_rad_s=c7, wz_body_rad_s=c8",
        f"columns={' '.join(HEADER)}",
    ):
        assert_same(judged(path, spec), expected(tmp_path))
    with expected_message.raises(bodycheck.InputError):
        judged(path, "columns=t_s qw qx qy qz")


def test_line_of_a_wrong_cell_counts_comments(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """The number is that of the line in the file."""
    path = tmp_path / "log.txt"
    path.write_text("# a\n\n# t_s x_m y_m z_m\n0 1 2 3\n# b\n1 2 high 3\n")
    with expected_message.raises(bodycheck.InputError):
        judged(path)


# ------------------------------------------------------------------------------------------- known sources


@pytest.mark.parametrize(
    ("name", "like"), [("tum.csv", "tum"), ("euroc.csv", "euroc"), ("attitude.aem", None), ("log.bag", None)]
)
def test_handed_files_are_read_or_refused_with_the_reason(
    name: str, like: str | None, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """Without a map, the message names the source, the missing keywords, or the known formats."""
    path = shutil.copy(CASES / name, tmp_path)
    with expected_message.raises(bodycheck.InputError):
        judged(path)
    if like is not None:
        assert judged(path, like=like)["orientation_error_rad"] > 0.01


def test_tum_and_kitti_and_euroc_are_read_like_the_same_motion(tmp_path: Path) -> None:
    """Order, unit and origin of each source are those of its files."""
    t_s, quaternion, omega = turned()
    rotation = Rotation.from_quat(quaternion, scalar_first=True)
    at = np.ones((12, 3))
    stamps = [EPOCH_NS + k * STEP_NS for k in range(12)]
    tum, kitti, euroc, imu = (tmp_path / name for name in ("tum.txt", "00.txt", "data.csv", "imu.csv"))
    rows = zip(map(as_seconds, stamps), np.column_stack([at, rotation.as_quat()]), strict=True)
    tum.write_text("".join(f"{stamp} {' '.join(map(repr, map(float, row)))}\n" for stamp, row in rows))
    np.savetxt(
        kitti, np.concatenate([rotation.as_matrix(), at[:, :, None]], axis=-1).reshape(12, 12), fmt="%.17g"
    )
    head = "#timestamp, " + ", ".join(
        [*(f"p_RS_R_{a} [m]" for a in "xyz"), *(f"q_RS_{a} []" for a in "wxyz"), "b_w_RS_S_x [rad s^-1]"]
    )
    body = np.column_stack([at, quaternion, np.zeros(12)])
    lines = [
        f"{stamp},{','.join(map(repr, map(float, row)))}" for stamp, row in zip(stamps, body, strict=True)
    ]
    euroc.write_text("\n".join([head, *lines]) + "\n")
    lines = [
        f"{stamp},{','.join(map(repr, map(float, row)))}" for stamp, row in zip(stamps, omega, strict=True)
    ]
    head = "#timestamp [ns]," + ",".join(f"w_RS_S_{a} [rad s^-1]" for a in "xyz")
    imu.write_text("\n".join([head, *lines]) + "\n")
    own = expected(tmp_path)
    assert_same(judged(tum, like="tum"), own)
    assert_same(judged(euroc, like="euroc"), own)
    assert judged(imu, like="euroc")["omega_error"] == pytest.approx(own["omega_error"], rel=1e-13)
    times = tmp_path / "times.txt"
    np.savetxt(times, t_s)
    assert_same(judged(kitti, f"times={times}", like="kitti"), own)
    arrays = recorded_motion(kitti, read_map((), "kitti"), 0.1).arrays
    np.testing.assert_array_equal(arrays["t_s"], np.arange(12) * 0.1)
    np.testing.assert_allclose(arrays["rotation"], rotation.as_matrix(), rtol=0, atol=1e-15)


def test_times_of_another_file_must_fit(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """A file of times with fewer rows is refused."""
    times, poses = tmp_path / "times.txt", tmp_path / "00.txt"
    times.write_text("0\n1\n")
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    with expected_message.raises(bodycheck.InputError):
        judged(poses, f"times={times}", like="kitti")


AEM = """CCSDS_AEM_VERS = {version}
CREATION_DATE = 2026-11-25T00:00:00
ORIGINATOR = TEST
COMMENT a message

META_START
OBJECT_NAME = TOP
OBJECT_ID = 2026-001A
REF_FRAME_A = {frames[0]}
REF_FRAME_B = {frames[1]}
{keywords}
TIME_SYSTEM = UTC
META_STOP
DATA_START
{rows}
DATA_STOP
"""


@pytest.mark.slow(after=8)
@pytest.mark.parametrize("date", ["2026-11-25T23:59:59.{ms:03}", "2026-329T23:59:{s:02}.{ms:03}"])
@pytest.mark.parametrize("order", ["FIRST", "LAST", "of version 2"])
@pytest.mark.parametrize("way", ["A2B", "B2A"])
@pytest.mark.parametrize("body_is_first", [False, True])
def test_attitude_messages_state_their_own_map(
    date: str, order: str, way: str, *, body_is_first: bool, tmp_path: Path
) -> None:
    """Both frames, both directions, both orders, dates and days of the year give the same motion."""
    if order == "of version 2" and way == "B2A":
        pytest.skip("version 2 has no direction")
    _, quaternion, omega = turned()
    to_world = body_is_first == (way == "B2A")
    q = Rotation.from_quat(quaternion, scalar_first=True)
    q = q if to_world else q.inv()
    frames = ["SC_BODY_1", "EME2000"] if body_is_first else ["EME2000", "SC_BODY_1"]
    keywords = [f"ATTITUDE_DIR = {way}", f"QUATERNION_TYPE = {order}", "ATTITUDE_TYPE = QUATERNION"]
    values = q.as_quat(scalar_first=order == "FIRST")
    if order == "of version 2":
        keywords = ["ATTITUDE_TYPE = QUATERNION/ANGVEL", "ANGVEL_FRAME = SC_BODY_1"]
        values = np.column_stack([values, np.rad2deg(omega)])
    rows = []
    for k, row in enumerate(values):
        second, ms = divmod(100 * k, 1000)
        # 23:59:58.0 and on, across midnight in the first form
        day = date.format(s=58 + second if second < 2 else 0, ms=ms) if "{s" in date else date.format(ms=ms)
        if "{s" not in date and second:
            day = f"2026-11-26T00:00:0{second - 1}.{ms:03}Z"
        rows.append(f"{day} {' '.join(map(repr, map(float, row)))}")
    path = tmp_path / "top.aem"
    version = "2.0" if order == "of version 2" else "1.0"
    path.write_text(
        AEM.format(version=version, frames=frames, keywords="\n".join(keywords), rows="\n".join(rows))
    )
    found = judged(path)
    own = expected(tmp_path)
    assert_same(found, own)
    assert ("omega_error" in found) == (order == "of version 2")


def test_attitude_messages_of_angles(tmp_path: Path) -> None:
    """Angles in degrees rotate about the axes of the body in their order, 321 or ZYX."""
    _, quaternion, omega = turned()
    rotation = Rotation.from_quat(quaternion, scalar_first=True)
    values = np.column_stack([rotation.as_euler("ZYX", degrees=True), np.rad2deg(rotation.apply(omega))])
    rows = [
        f"2026-11-25T00:00:{k // 10:02}.{k % 10} {' '.join(map(repr, map(float, row)))}"
        for k, row in enumerate(values)
    ]
    for sequence in ("321", "ZYX"):
        keywords = [
            "ATTITUDE_TYPE = EULER_ANGLE/ANGVEL",
            f"EULER_ROT_SEQ = {sequence}",
            "ANGVEL_FRAME = EME2000",
        ]
        path = tmp_path / "top.aem"
        path.write_text(
            AEM.format(
                version="2.0",
                frames=("EME2000", "SC_BODY_1"),
                keywords="\n".join(keywords),
                rows="\n".join(rows),
            )
        )
        found, own = judged(path), expected(tmp_path)
        assert_same(found, own)
        assert found["omega_error"] == pytest.approx(own["omega_error"], rel=1e-12)


WRONG_MESSAGES = {
    "two bodies": ("1.0", ("SC_BODY_1", "SC_BODY_2"), "ATTITUDE_TYPE = QUATERNION"),
    "a spin": ("2.0", ("EME2000", "SC_BODY_1"), "ATTITUDE_TYPE = SPIN"),
    "angles without an order": ("2.0", ("EME2000", "SC_BODY_1"), "ATTITUDE_TYPE = EULER_ANGLE"),
    "too few values": ("2.0", ("EME2000", "SC_BODY_1"), "ATTITUDE_TYPE = QUATERNION"),
}


@pytest.mark.parametrize("what", WRONG_MESSAGES)
def test_attitude_message_without_a_meaning_is_refused(
    what: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The message names the keyword."""
    version, frames, keywords = WRONG_MESSAGES[what]
    if version == "1.0":
        keywords += "\nATTITUDE_DIR = A2B\nQUATERNION_TYPE = LAST"
    path = tmp_path / "top.aem"
    rows = "2026-01-01T00:00:00 0 0 0"
    path.write_text(AEM.format(version=version, frames=frames, keywords=keywords, rows=rows))
    with expected_message.raises(bodycheck.InputError):
        judged(path)


# --------------------------------------------------------------------------------- Rodrigues parameters


@pytest.mark.parametrize("kind", ["rodrigues", "modified_rodrigues"])
@pytest.mark.parametrize("attitude", ["body-to-world", "world-to-body"])
def test_rodrigues_parameters_are_an_attitude(kind: str, attitude: str, tmp_path: Path) -> None:
    """e tan(angle / 2) and e tan(angle / 4), the latter also beyond half a turn."""
    t_s, quaternion, _ = turned()
    rotation = Rotation.from_quat(quaternion, scalar_first=True)
    rotation = rotation.inv() if attitude == "world-to-body" else rotation
    vector = rotation.as_rotvec()
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    axis = np.divide(vector, angle, out=np.zeros_like(vector), where=angle > 0.0)
    if kind == "modified_rodrigues":
        angle[5] -= 2.0 * np.pi  # the same attitude, from the other side
    values = axis * np.tan(angle / (2.0 if kind == "rodrigues" else 4.0))
    path = tmp_path / "log.csv"
    names = [f"{kind}_{a}" for a in "xyz"]
    pd.DataFrame(np.column_stack([t_s, values]), columns=["t_s", *names]).to_csv(path, index=False)
    found = judged(path, f"attitude={attitude}")
    assert_same(found, expected(tmp_path))
    assert "quaternion_norm_error" not in found
