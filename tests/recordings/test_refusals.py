"""Recordings and maps that are wrong: one clear line each, which says what would be right."""

from __future__ import annotations

import contextlib
import io
import json
import random
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bodycheck
from bodycheck.recordings.column_map import (
    CONVENTIONS,
    KINDS,
    UNITS,
    parse_product,
    read_map,
    source,
    source_names,
)
from bodycheck.recordings.conversion import recorded_motion
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reports.run_files.tables import as_parquet
from bodycheck.scenarios.library import scenario_names
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.file_mutations import any_bytes, csv_cell, json_value, toml_line

MESSAGES = tomllib.loads((Path(__file__).parents[1] / "expected_messages.toml").read_text())
EXPECTED = {key: text for messages in MESSAGES.values() for key, text in messages.items()}
RATES = "t_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"


@pytest.mark.parametrize("suffix", ["", ".zip", ".gz", ".bz2", ".xz", ".zst", ".tar", ".tar.gz"])
def test_compression_is_not_derived_from_the_name(suffix: str, tmp_path: Path) -> None:
    """A text file is read as text, whatever its name; another is refused in one line."""
    path = tmp_path / f"judged.csv{suffix}"
    path.write_text("t_s,x_m,y_m,z_m\n0.0,1.0,2.0,3.0\n")
    assert recorded_motion(path, read_map(())).arrays["position_m"].tolist() == [[1.0, 2.0, 3.0]]
    path.write_bytes(b"PK\x03\x04\xff\xfe" + bytes(50))
    with pytest.raises(bodycheck.InputError) as refused:
        recorded_motion(path, read_map(()))
    assert str(refused.value).startswith(f"{path}: ")


@pytest.mark.parametrize("cell", ["1+2j", "9007199254740993", "True", "x", "1_0", ""])
def test_cell_that_is_not_a_double_is_refused(cell: str, tmp_path: Path) -> None:
    """Numbers beyond double precision and booleans are refused."""
    path = tmp_path / "judged.csv"
    path.write_text(f"t_s,x_m,y_m,z_m\n0.0,{cell},2.0,3.0\n")
    with pytest.raises(bodycheck.InputError, match="x_m"):
        recorded_motion(path, read_map(()))


MAPS: dict[str, Any] = {
    "no pair": "p_deg_s*deg",
    "no value": "wx_body_rad_s=",
    "unknown key": "wx_bodi_rad_s=p",
    "unknown unit": "wx_body_rad_s=p*furlong",
    "a call": "wx_body_rad_s=abs(p)",
    "a sum": "wx_body_rad_s=p+q",
    "an attribute": "wx_body_rad_s=p.__class__",
    "two factors": "wx_body_rad_s=p q",
    "trailing sign": "wx_body_rad_s=p*",
    "a length for a rate": "wx_body_rad_s=p*ft",
    "divided by a column": "wx_body_rad_s=1/p",
    "divided by zero": "wx_body_rad_s=p/0",
    "infinite factor": "wx_body_rad_s=p*1e999",
    "open quotation mark": 'wx_body_rad_s="p',
    "a unit that is a column": "wx_body_rad_s=p*deg",
    "no sequence": "euler=ZZX",
    "mixed sequence": "euler=zYx",
    "left-handed world": "world=NEU to ENU",
    "unknown direction": "body=FRQ to FLU",
    "one frame": "world=NED",
    "unknown way": "attitude=inertial",
    "no rate": "earth_rate_rad_s=fast",
    "column that is missing": "wx_body_rad_s=pp",
    "no file": "none.toml",
    "not a product": {"wx_body_rad_s": [1]},
    "a number for a text": {"euler": 3},
}


@pytest.mark.parametrize("what", MAPS)
def test_wrong_map_is_refused_in_one_line(
    what: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The message names the key and what is accepted."""
    path = tmp_path / "log.csv"
    path.write_text("t_s,p,q,r,deg\n0,1,2,3,4\n")
    with pytest.raises(bodycheck.InputError) as refused:
        recorded_motion(path, read_map([MAPS[what]]))
    assert "\n" not in str(refused.value)
    expected_message(str(refused.value), tmp_path)


def turning(omega: tuple[float, ...]) -> str:
    """Return a recording of a body that turns about its z axis, which points along x of the world."""
    start = np.array([0.5**0.5, 0.0, 0.5**0.5, 0.0])
    lines = ["t,qw,qx,qy,qz,wx,wy,wz"]
    for t in np.linspace(0.0, 2.0, 41):
        turned = quaternion_product(start, exp_quaternion(np.array([0.0, 0.0, 0.5 * t])))
        lines.append(",".join(repr(float(one)) for one in (t, *turned, *omega)))
    return "\n".join(lines) + "\n"


FILES: dict[str, tuple[str, str, str]] = {
    "unknown columns": (
        "log.csv",
        "time,p_deg_s,q_deg_s,r_deg_s,yaw_deg,pitch_deg,roll_deg,temp\n0,1,2,3,0,0,0,20\n",
        "",
    ),
    "units in brackets": (
        "log.csv",
        "Time (s),pos_x (ft),pos_y (ft),pos_z (ft),q0,q1,q2,q3,gyro_x[dps],gyro_y[dps],gyro_z[dps]\n"
        "0,1,2,3,1,0,0,0,1,2,3\n",
        "",
    ),
    "misspelt columns": ("log.csv", "t_s,wx_bodi_rad_s,wy_bodi_rad_s,wz_bodi_rad_s\n0,1,2,3\n", ""),
    "columns of a source": (
        "log.csv",
        ",".join(name.strip('"').partition('"')[0] for name in source("nesc")["map"].values() if '"' in name)
        + ",mach\n"
        + ",".join("0" * 10)
        + "\n",
        "",
    ),
    "columns that a map leaves": ("log.csv", "t_s,p,q,r,mach\n0,1,2,3,4\n", "wx_body_rad_s=p"),
    "a column twice": ("log.csv", "t_s,p,p\n0,1,2\n", "wx_body_rad_s=p"),
    "angles without a sequence": (
        "log.csv",
        "t_s,euler_1_rad,euler_2_rad,euler_3_rad\n0,1,2,3\n",
        "",
    ),
    "angles and a quaternion": (
        "log.csv",
        "t_s,qw,qx,qy,qz,euler_1_rad,euler_2_rad,euler_3_rad\n0,1,0,0,0,1,2,3\n",
        "euler=ZYX",
    ),
    "a sequence without angles": ("log.csv", f"{RATES}\n0,1,2,3\n", "euler=ZYX"),
    "a place without a start": (
        "log.csv",
        "t_s,qw,qx,qy,qz,longitude_rad,latitude_rad\n1,1,0,0,0,0,0\n",
        "",
    ),
    "a place and a position": (
        "log.csv",
        "t_s,x_m,y_m,z_m,longitude_rad,latitude_rad\n0,1,0,0,0,0\n",
        "",
    ),
    "a speed without an attitude": (
        "log.csv",
        "t_s,vx_body_m_s,vy_body_m_s,vz_body_m_s\n0,1,0,0\n",
        "",
    ),
    "stamps and half a vector": (
        "log.csv",
        "stamp,gyro_x,gyro_y,gyro_z,acc_x,pos_x\n1403715524907143168,1,2,3,4,5\n1403715525007143168,1,2,3,4,5\n",
        "",
    ),
    "omega in world axes": ("log.csv", turning((0.5, 0.0, 0.0)), ""),
    "omega in no axes": ("log.csv", turning((0.0, 0.5, 0.0)), ""),
    "a quaternion and angles": (
        "log.txt",
        "time;q0;q1;q2;q3;roll;pitch;yaw\n0;1;0;0;0;0;0;0\n0,1;1;0;0;0;0;0;0\n",
        "",
    ),
    "poses of KITTI": ("00.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n", ""),
    "modified Rodrigues parameters": ("log.csv", "time [ms],mrp1,mrp2,mrp3\n0,0,0,0\n10,0,0,0.1\n", ""),
    "text in JSON": ("log.jsonl", '{"t_s": 0, "x_m": 1, "y_m": "a", "z_m": 1}\n', ""),
    "no JSON": ("log.jsonl", '{"t_s": 0}\n{"t_s": 1\n', ""),
    "no object": ("log.jsonl", "[1]\n", ""),
    "a missing value": ("log.jsonl", '{"t_s": 0, "x_m": 1}\n{"t_s": 1}\n', "y_m=0, z_m=0"),
    "a number that is too large": ("log.jsonl", '{"t_s": 9007199254740993}\n', ""),
    "an empty file": ("log.jsonl", "\n", ""),
    "no Parquet": ("log.parquet", "PAR1 is not all", ""),
    "no MCAP": ("log.mcap", "MCAP is not all", ""),
}


@pytest.mark.parametrize("what", FILES)
def test_wrong_recording_is_refused_in_one_line(
    what: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The message names the file, what is wrong, and the map that comes nearest."""
    if "MCAP" in what:
        pytest.importorskip("mcap", reason="MCAP is an optional format")
    name, text, spec = FILES[what]
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(bodycheck.InputError) as refused:
        recorded_motion(path, read_map([spec] if spec else ()))
    assert "\n" not in str(refused.value)
    expected_message(str(refused.value), tmp_path)


PROPOSAL = re.compile(r"try (--.*?)(?: \(.*\))?$")
CASES = Path(__file__).parent / "cases"
PROPOSING = {
    **{f"wrong_recording_is_refused_in_one_line[{what}]": what for what in FILES},
    "handed_files_are_read_or_refused_with_the_reason[euroc.csv-euroc]": "euroc.csv",
    "handed_files_are_read_or_refused_with_the_reason[tum.csv-tum]": "tum.csv",
}


@pytest.mark.parametrize("key", PROPOSING)
def test_proposed_options_read_the_file(key: str, tmp_path: Path) -> None:
    """What a message proposes for a file works, with the map that was given before."""
    what = PROPOSING[key]
    name, text, spec = FILES[what] if what in FILES else (what, (CASES / what).read_text(), "")
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(bodycheck.InputError) as refused:
        recorded_motion(path, read_map([spec] if spec else ()))
    proposed = PROPOSAL.search(str(refused.value))
    assert (proposed is None) == ("try --" not in EXPECTED.get(key, ""))
    if proposed is None:
        return
    words = shlex.split(proposed[1])
    options = dict(zip(words[::2], words[1::2], strict=True))
    assert set(options) <= {"--map", "--like", "--dt"}
    maps = [*([spec] if spec else []), *([options["--map"]] if "--map" in options else [])]
    dt_s = float(options["--dt"]) if "--dt" in options else None
    arrays = recorded_motion(path, read_map(maps, options.get("--like")), dt_s).arrays
    assert len(arrays) >= 2
    if "omega_body_rad_s" in arrays and what in ("unknown columns", "units in brackets"):
        assert arrays["omega_body_rad_s"][0, 2] == pytest.approx(np.deg2rad(3.0), rel=1e-15)


@pytest.mark.parametrize(
    ("yaw", "rate", "is_assumed"),
    [
        ((0.0, 9.0, 18.0), 90.0, True),  # degrees, as the ratio of both says
        ((0.0, 0.15, 0.3), 1.5, True),
        ((0.0, 9.0, 18.0), 80.0, False),  # what is judged may be this very difference
        ((0.0, 9.0, 18.0), -90.0, False),
        ((0.0, 9.0, 18.0), 0.0, False),
    ],
)
def test_a_map_that_the_file_confirms_is_assumed(
    yaw: tuple[float, ...], rate: float, is_assumed: bool, tmp_path: Path
) -> None:
    """Where omega is the rate of the attitude, columns, axes and units are settled; else one is proposed."""
    path = tmp_path / "log.csv"
    rows = "".join(f"{0.1 * k},0,0,{rate},0,0,{angle}\n" for k, angle in enumerate(yaw))
    path.write_text(f"time,gx,gy,gz,roll,pitch,yaw\n{rows}")
    if not is_assumed:
        with pytest.raises(bodycheck.InputError, match="; try --map"):
            recorded_motion(path, read_map([]))
        return
    found = recorded_motion(path, read_map([]))
    unit = np.pi / 180.0 if yaw[-1] > 1.0 else 1.0
    np.testing.assert_allclose(found.arrays["omega_body_rad_s"][:, 2], rate * unit, rtol=1e-15)
    map_text = shlex.split(found.assumed)[1]
    given = recorded_motion(path, read_map([map_text]))
    assert not given.assumed
    assert all(np.array_equal(given.arrays[name], array) for name, array in found.arrays.items())


@pytest.mark.parametrize(("name", "is_read"), [("omega_body_{}_rad_s", True), ("omega_{}", False)])
def test_columns_that_state_axes_and_unit_are_read_as_they_are_named(
    name: str, is_read: bool, tmp_path: Path
) -> None:
    """Degrees under a name with rad/s are not converted: they may be the fault that is looked for."""
    path = tmp_path / "log.csv"
    rows = "".join(
        f"{t},{np.cos(t / 2)},0,0,{np.sin(t / 2)},0,0,{np.rad2deg(1.0)}\n" for t in (0.0, 0.1, 0.2)
    )
    path.write_text(f"t_s,qw,qx,qy,qz,{','.join(name.format(axis) for axis in 'xyz')}\n{rows}")
    found = recorded_motion(path, read_map([]))
    stated = np.rad2deg(1.0) if is_read else 1.0
    np.testing.assert_allclose(found.arrays["omega_body_rad_s"][:, 2], stated, rtol=1e-15)
    assert ("as its columns are named" in found.assumed) == is_read


def test_the_sensors_of_a_stored_motion_are_not_compared(tmp_path: Path) -> None:
    """The npz of a case has what an engine's accelerometer and gyro read besides the motion."""
    n = np.zeros((3, 3))
    path = tmp_path / "case.npz"
    np.savez(path, t_s=np.arange(3.0), omega_body_rad_s=n, specific_force_m_s2=n, gyro_rad_s=n)
    assert set(recorded_motion(path, read_map([])).arrays) == {"t_s", "omega_body_rad_s"}


def test_every_proposal_of_the_tests_is_run() -> None:
    """A message with a proposal belongs to a file of the test above."""
    proposing = {key for key, text in EXPECTED.items() if "try --" in text}
    assert proposing
    assert proposing <= set(PROPOSING)


def test_later_map_takes_precedence(tmp_path: Path) -> None:
    """A file, pairs and a mapping may be combined; ignored columns accumulate."""
    (tmp_path / "map.toml").write_text('wx_body_rad_s = "p*deg"\nignore = ["a"]\neuler = "ZYX"\n')
    found = read_map([tmp_path / "map.toml", 'wx_body_rad_s = -2*"p" / s, ignore=b', {"z_m": 0.5}])
    assert found.products["wx_body_rad_s"].settled("wx_body_rad_s", ["p"]) == (-2.0, ("p",))
    assert found.products["z_m"].settled("z_m", []) == (0.5, ())
    assert (found.ignore, found.euler) == (("a", "b"), "ZYX")


@pytest.mark.parametrize("unit", UNITS)
def test_unit_is_that_of_its_kind(unit: str) -> None:
    """Each unit is accepted for the quantities of its kind, and refused for a quaternion."""
    product = parse_product(f"p*{unit}", "key")
    fitting = [target for target in KINDS if _settles(product, target)]
    assert fitting
    assert "qw" not in fitting
    scales = {product.settled(target, ["p"])[0] for target in fitting}
    assert scales == {UNITS[unit][0]}


def _settles(product: Any, target: str) -> bool:
    try:
        product.settled(target, ["p"])
    except bodycheck.InputError:
        return False
    return True


@pytest.mark.parametrize("name", source_names())
def test_built_in_source_is_a_map(name: str) -> None:
    """A source is a valid map of a whole attitude or rates, and its scenarios exist."""
    found = read_map((), name)
    defined = {*found.products, *found.optional, *found.columns}
    assert name in ("aem", "kitti") or "t_s" in defined
    assert name == "aem" or {"qw", "r00", "euler_1_rad"} & defined
    assert set(source(name)) <= {"map", "optional", "scenarios"}
    assert set(source(name).get("scenarios", {}).values()) <= set(scenario_names())
    assert not set(KINDS) & set(CONVENTIONS)


def json_line(content: bytes, dice: random.Random) -> bytes:
    """Return JSON lines with a value of one line changed."""
    lines = content.splitlines()
    place = dice.randrange(len(lines))
    lines[place] = json_value(lines[place], dice).replace(b"\n", b"")
    return b"\n".join(lines)


MESSAGE = """CCSDS_AEM_VERS = 2.0
META_START
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
ATTITUDE_TYPE = QUATERNION/ANGVEL
ANGVEL_FRAME = SC_BODY_1
META_STOP
DATA_START
2026-01-01T00:00:00 0 0 0 1 1 2 3
2026-01-01T00:00:01 0 0 0 1 1 2 3
DATA_STOP
"""


def sound_files(folder: Path) -> dict[str, tuple[Path, Any]]:
    """Write one sound recording of every format, and return what damages it."""
    table = pd.DataFrame({"time": [0.0, 0.5, 1.0], "p": [1.0, 2.0, 3.0], "q": 0.0, "r": 1.0})
    table.to_csv(folder / "log.csv", index=False)
    lines = (json.dumps(row) for row in table.to_dict("records"))
    (folder / "log.jsonl").write_text("".join(line + "\n" for line in lines))
    (folder / "log.parquet").write_bytes(as_parquet(table))
    content = io.BytesIO()
    np.savez(content, **{name: table[name].to_numpy() for name in table})
    (folder / "log.npz").write_bytes(content.getvalue())
    (folder / "map.toml").write_text('t_s = "time"\nwx_body_rad_s = "p*deg"\nworld = "NED to ENU"\n')
    table.to_csv(folder / "log.txt", sep=" ", index=False)
    (folder / "log.aem").write_text(MESSAGE)
    found = {
        "csv": (folder / "log.csv", csv_cell),
        "txt": (folder / "log.txt", any_bytes),
        "aem": (folder / "log.aem", any_bytes),
        "jsonl": (folder / "log.jsonl", json_line),
        "parquet": (folder / "log.parquet", any_bytes),
        "npz": (folder / "log.npz", any_bytes),
        "toml": (folder / "map.toml", toml_line),
    }
    with contextlib.suppress(ImportError):
        from mcap.writer import Writer

        with (folder / "log.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start()
            channel = writer.register_channel("/a", "json", writer.register_schema("a", "jsonschema", b"{}"))
            for k, row in enumerate(table.to_dict("records")):
                writer.add_message(channel, k, json.dumps(row).encode(), k)
            writer.finish()
        found["mcap"] = (folder / "log.mcap", any_bytes)
    return found


@contextlib.contextmanager
def one_line() -> Iterator[None]:
    """Fail where an InputError has several lines."""
    try:
        yield
    except bodycheck.InputError as error:
        if "\n" in str(error).strip():
            raise AssertionError(f"several lines: {error}") from error
        raise


MAP = "t_s=time, wx_body_rad_s=p*deg, wy_body_rad_s=q*deg, wz_body_rad_s=r*deg, ignore=*"


@pytest.mark.slow
@pytest.mark.nightly(after=4)
@pytest.mark.parametrize("kind", ["csv", "txt", "aem", "jsonl", "parquet", "npz", "toml", "mcap"])
def test_damaged_recording_is_read_or_refused(kind: str, tmp_path: Path) -> None:
    """Seeded mutations of a recording or a map cause an InputError of one line or none."""
    files = sound_files(tmp_path)
    if kind not in files:
        pytest.skip("MCAP is an optional format")
    path, mutate = files[kind]
    sound, damaged = path.read_bytes(), path.with_name(f"damaged{path.suffix}")
    for seed in range(12 if kind == "parquet" else 60):  # each opens a database
        damaged.write_bytes((mutate if seed % 2 else any_bytes)(sound, random.Random(seed)))
        with contextlib.suppress(bodycheck.InputError), one_line():
            if kind == "toml":
                recorded_motion(files["csv"][0], read_map([MAP, damaged]))
            else:
                recorded_motion(damaged, read_map([MAP]))


def test_npz_with_text_is_read_where_the_text_is_not_used(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """An array of names or a pickle in an npz is refused only if a map uses it."""
    path = tmp_path / "log.npz"
    rates = np.arange(6.0).reshape(2, 3)
    np.savez(path, time=np.array([0.0, 1.0]), w=rates, names=np.array(["a", "b"]), mass=np.float64(2.0))
    keys = {"t_s": "time"} | {f"w{axis}_body_rad_s": f"w[{i}]*deg" for i, axis in enumerate("xyz")}
    arrays = recorded_motion(path, read_map([keys, "ignore=names"])).arrays
    np.testing.assert_allclose(arrays["omega_body_rad_s"], np.deg2rad(rates), rtol=1e-15)
    with expected_message.raises(bodycheck.InputError):
        recorded_motion(path, read_map([keys, "z_m=names"]))


def test_metadata_of_an_npz_is_left_out(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """Text and arrays of another length are no columns, and are refused only where a map uses them."""
    path = tmp_path / "log.npz"
    series = {"t_s": np.arange(5.0), "quaternion": np.tile(np.eye(4)[0], (5, 1))}
    np.savez(path, inertia=np.eye(3), mass=2.0, author=np.array(["me"]), **series)
    assert {*recorded_motion(path, read_map([])).arrays} == {*series}
    with expected_message.raises(bodycheck.InputError):
        recorded_motion(path, read_map(["x_m=inertia[0]"]))


@pytest.mark.parametrize("pattern", ["rotation", "rotat*", "r??"])
def test_an_array_is_ignored_by_its_name_or_its_columns(pattern: str, tmp_path: Path) -> None:
    """The elements of an npz array also have the names of standard columns."""
    path = tmp_path / "both.npz"
    times, turned = np.array([0.0, 1.0]), np.array([np.eye(3)] * 2)
    np.savez(path, t_s=times, quaternion=np.array([[0.6, 0.8, 0.0, 0.0]] * 2), rotation=turned)
    assert {*recorded_motion(path, read_map([f"ignore={pattern}"])).arrays} == {"t_s", "quaternion"}


def test_a_misspelt_array_of_an_npz_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """It would not be judged, and nobody would notice."""
    path = tmp_path / "log.npz"
    np.savez(path, t_s=[0.0, 1.0], quaternion=np.eye(4)[[0, 0]], omega_bdy_rad_s=np.ones((2, 3)))
    with expected_message.raises(bodycheck.InputError):
        recorded_motion(path, read_map([]))


def test_the_line_of_a_wrong_cell_counts_blank_lines(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The number is that of the line in the file."""
    path = tmp_path / "log.csv"
    path.write_text(f"{RATES}\n\n0,1,2,3\n\n1,1,x,3\n")
    with expected_message.raises(bodycheck.InputError):
        recorded_motion(path, read_map([]))


@pytest.mark.parametrize(("pattern", "is_read"), [("q?", False), ("*", True), ("aero", True)])
def test_a_pattern_ignores_standard_columns_too_except_for_the_star(
    pattern: str, is_read: bool, tmp_path: Path
) -> None:
    """`*` stands for the columns that nothing uses; another pattern means what it says."""
    path = tmp_path / "log.csv"
    path.write_text(f"{RATES},qw,qx,qy,qz,aero\n0,1,2,3,1,0,0,0,5\n1,1,2,3,1,0,0,0,5\n")
    arrays = recorded_motion(path, read_map([f"ignore={pattern}", "ignore=aero"])).arrays
    assert "omega_body_rad_s" in arrays
    assert ("quaternion" in arrays) is is_read
