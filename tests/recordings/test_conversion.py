"""Recordings: the same motion, in any format and under any map, is judged alike."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import bodycheck
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.tables import as_parquet
from bodycheck.reports.run_files.trajectory_files import COLUMNS, npz
from tests.helpers.expected_messages import ExpectedMessage

SCENARIO = "free-flight"
EARTH_RATE_RAD_S = 7.292115e-5
NO_QUATERNION = {"quaternion_norm_error"}
ABSOLUTE = 3e-14  # a handful of roundings of angles of some radians


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded motion, near the truth at uneven times, in the axes and units of bodycheck."""

    t_s: Array
    position_m: Array
    quaternion: Array
    velocity_m_s: Array
    omega_body_rad_s: Array

    @property
    def rotation(self) -> Rotation:
        """The orientation as a rotation of SciPy, with which the recordings here are written."""
        return Rotation.from_quat(self.quaternion, scalar_first=True)

    def as_recorded(self) -> dict[str, Array]:
        """Return the columns that need no map."""
        arrays = {name: getattr(self, name) for name in COLUMNS if hasattr(self, name) and name != "rotation"}
        columns = {"t_s": self.t_s}
        for name, array in arrays.items():
            columns |= dict(zip(COLUMNS[name], array.T, strict=True))
        return columns


def motion(seed: int) -> Motion:
    """Return the truth at random times, moved at random by a tenth, whatever the laws of motion say."""
    rng = np.random.default_rng([23, seed])
    t_s = np.array([0.0, *np.sort(rng.integers(1, 2**30, 12))]) / 2.0**30  # exact also when 1024 s is added
    true = bodycheck.truth(SCENARIO, list(t_s)).trajectory
    turned = Rotation.from_quat(true.attitude, scalar_first=True)
    turned = Rotation.from_rotvec(0.1 * rng.normal(size=(13, 3))) * turned
    return Motion(
        t_s,
        true.position_m + 0.1 * rng.normal(size=(13, 3)),
        turned.as_quat(scalar_first=True),
        true.velocity_m_s + 0.1 * rng.normal(size=(13, 3)),
        true.omega_body + 0.1 * rng.normal(size=(13, 3)),
    )


def write_csv(columns: Mapping[str, Array], path: Path) -> Path:
    """Write columns as CSV and return the path."""
    pd.DataFrame(dict(columns)).to_csv(path.with_suffix(".csv"), index=False)
    return path.with_suffix(".csv")


def write_npz(columns: Mapping[str, Array], path: Path) -> Path:
    """Write columns as arrays (n,) of an npz and return the path."""
    path.with_suffix(".npz").write_bytes(npz(columns))
    return path.with_suffix(".npz")


def write_parquet(columns: Mapping[str, Array], path: Path) -> Path:
    """Write columns as Parquet and return the path."""
    path.with_suffix(".parquet").write_bytes(as_parquet(pd.DataFrame(dict(columns))))
    return path.with_suffix(".parquet")


def write_json_lines(columns: Mapping[str, Array], path: Path) -> Path:
    """Write one JSON object per line and return the path."""
    rows = pd.DataFrame(dict(columns)).to_dict("records")
    path.with_suffix(".jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path.with_suffix(".jsonl")


def write_mcap(columns: Mapping[str, Array], path: Path) -> Path:
    """Write the rows as JSON messages of one topic, with a log time since 1970, and return the path."""
    writer_module = pytest.importorskip("mcap.writer", reason="MCAP is an optional format")
    with path.with_suffix(".mcap").open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start()
        schema = writer.register_schema("state", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/state", "json", schema)
        for number, row in enumerate(pd.DataFrame(dict(columns)).to_dict("records")):
            stamp = 1_700_000_000_000_000_000 + number
            writer.add_message(channel, stamp, json.dumps(row).encode(), stamp)
        writer.finish()
    return path.with_suffix(".mcap")


FORMATS: dict[str, Callable[[Mapping[str, Array], Path], Path]] = {
    "csv": write_csv,
    "npz": write_npz,
    "parquet": write_parquet,
    "json lines": write_json_lines,
    "mcap": write_mcap,
}

Recorded = tuple[dict[str, Array], dict[str, Any]]
"""The columns as another program writes them, and the map that undoes it."""


def as_it_is(m: Motion, _: np.random.Generator) -> Recorded:
    """The columns of bodycheck."""
    return m.as_recorded(), {}


def other_units(m: Motion, _: np.random.Generator) -> Recorded:
    """Milliseconds, feet, feet per minute, degrees per second."""
    x, v, w = m.position_m / 0.3048, m.velocity_m_s / 0.3048 * 60.0, np.rad2deg(m.omega_body_rad_s)
    columns = {"t ms": m.t_s * 1e3, "s": 3.0 * np.ones(13)}
    columns |= {f"x{i} (ft)": x[:, i] for i in range(3)} | {f"v{i}": v[:, i] for i in range(3)}
    columns |= {name: w[:, i] for i, name in enumerate("pqr")}
    columns |= {f"q{i}": m.quaternion[:, i] for i in range(4)}
    keys = {"t_s": '"t ms"*ms', "ignore": ["s"]}
    keys |= {f"{a}_m": f'"x{i} (ft)"*ft' for i, a in enumerate("xyz")}
    keys |= {f"v{a}_m_s": f"v{i} * ft / min" for i, a in enumerate("xyz")}
    keys |= {f"w{a}_body_rad_s": f"{name}*deg" for a, name in zip("xyz", "pqr", strict=True)}
    keys |= {f"q{part}": f"q{i}" for i, part in enumerate("wxyz")}
    return columns, keys


def rates_only(m: Motion, _: np.random.Generator) -> Recorded:
    """Revolutions per minute, and nothing else."""
    columns = {"t_s": m.t_s} | {f"n{i}": m.omega_body_rad_s[:, i] * 30.0 / np.pi for i in range(3)}
    return columns, {f"w{axis}_body_rad_s": f"n{i}*rpm" for i, axis in enumerate("xyz")}


def euler_angles(m: Motion, rng: np.random.Generator) -> Recorded:
    """Degrees of a random sequence, about the axes of the body or of the world."""
    sequences = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "XYX", "XZX", "YXY", "YZY", "ZXZ", "ZYZ")
    sequence = str(rng.choice(sequences))
    sequence = sequence.lower() if rng.uniform() < 0.5 else sequence
    angles = m.rotation.as_euler(sequence, degrees=True)
    columns = m.as_recorded() | {f"a{i}": angles[:, i] for i in range(3)}
    columns = {name: values for name, values in columns.items() if name not in COLUMNS["quaternion"]}
    return columns, {"euler": sequence} | {f"euler_{i + 1}_rad": f"a{i}*deg" for i in range(3)}


def scalar_last(m: Motion, _: np.random.Generator) -> Recorded:
    """A quaternion (x, y, z, w) that takes world to body axes."""
    columns = m.as_recorded()
    q = m.rotation.inv().as_quat()
    for name in COLUMNS["quaternion"]:
        del columns[name]
    columns |= {f"quat[{i}]": q[:, i] for i in range(4)}
    keys = {f"q{part}": f"quat[{i}]" for i, part in enumerate("xyzw")}
    return columns, {**keys, "attitude": "world-to-body"}


def matrix(m: Motion, _: np.random.Generator) -> Recorded:
    """The rows of the matrix that takes body to world axes."""
    columns = {"t_s": m.t_s}
    return columns | {f"r{i}{j}": m.rotation.as_matrix()[:, i, j] for i in range(3) for j in range(3)}, {}


def north_east_down(m: Motion, _: np.random.Generator) -> Recorded:
    """World axes north-east-down for east-north-up, body axes forward-right-down for forward-left-up."""
    world = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    body = Rotation.from_matrix(np.diag([1, -1, -1]))
    q = (world * m.rotation * body.inv()).as_quat(scalar_first=True)
    omega_world = world.apply(m.rotation.apply(m.omega_body_rad_s))
    columns = Motion(
        m.t_s, world.apply(m.position_m), q, world.apply(m.velocity_m_s), omega_world
    ).as_recorded()
    renamed = {name.replace("_body_", "_world_"): values for name, values in columns.items()}
    return renamed, {"world": "NED to ENU", "body": "FRD to FLU"}


def velocity_in_body_axes(m: Motion, _: np.random.Generator) -> Recorded:
    """Velocities in knots along the axes of the body, from a log that starts at 1000 s."""
    columns = m.as_recorded()
    v = m.rotation.inv().apply(m.velocity_m_s) * 3600.0 / 1852.0
    columns = {name: values for name, values in columns.items() if not name.startswith("v")}
    columns |= {name: v[:, i] for i, name in enumerate("uvw")} | {"t_s": m.t_s + 1024.0}
    keys = {f"v{axis}_body_m_s": f"{name}*kn" for axis, name in zip("xyz", "uvw", strict=True)}
    return columns, {**keys, "time_origin": "first-sample"}


def over_the_earth(m: Motion, rng: np.random.Generator) -> Recorded:
    """Yaw, pitch and roll relative to local north, east and down, of a vehicle that moves over the Earth."""
    longitude, latitude = rng.uniform(-3.0, 3.0) + 0.2 * m.t_s, rng.uniform(-1.2, 1.2) + 0.1 * m.t_s
    inertial = longitude + EARTH_RATE_RAD_S * m.t_s
    sine, cosine = np.sin(inertial), np.cos(inertial)
    north = np.stack([-np.sin(latitude) * cosine, -np.sin(latitude) * sine, np.cos(latitude)], axis=-1)
    east = np.stack([-sine, cosine, np.zeros_like(sine)], axis=-1)
    local = Rotation.from_matrix(np.stack([north, east, np.cross(north, east)], axis=-1))
    angles = (local.inv() * local[0] * m.rotation).as_euler("ZYX", degrees=True)
    place = np.rad2deg(np.stack([longitude, latitude], axis=-1))
    names = ("yaw", "pitch", "roll"), ("lon", "lat")
    columns = {"t_s": m.t_s} | dict(zip(COLUMNS["omega_body_rad_s"], m.omega_body_rad_s.T, strict=True))
    columns |= dict(zip((*names[0], *names[1]), (*angles.T, *place.T), strict=True))
    keys = {f"euler_{i}_rad": f"{name}*deg" for i, name in enumerate(names[0], 1)}
    return columns, {**keys, "longitude_rad": "lon*deg", "latitude_rad": "lat*deg", "euler": "ZYX"}


WAYS = (
    *(as_it_is, other_units, rates_only, euler_angles, scalar_last, matrix),
    *(north_east_down, velocity_in_body_axes, over_the_earth),
)


@pytest.fixture(scope="module")
def motions(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Motion, dict[str, Any]]]:
    """Return random motions, and how each is judged from an npz of bodycheck's own."""
    path = tmp_path_factory.mktemp("own") / "own.npz"
    found = []
    for seed in range(4):
        m = motion(seed)
        path.write_bytes(npz(vars(m)))
        found.append((m, bodycheck.judge(path, SCENARIO)))
    return found


@pytest.mark.slow(after=2)
@pytest.mark.nightly(after=3)
@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
def test_same_motion_is_judged_alike(
    way: Callable[[Motion, np.random.Generator], Recorded],
    kind: str,
    motions: list[tuple[Motion, dict[str, Any]]],
    tmp_path: Path,
) -> None:
    """Every measure that a recording allows is the measure of the same motion in bodycheck's own units."""
    for seed, (m, expected) in enumerate(motions):
        columns, keys = way(m, np.random.default_rng([5, seed]))
        path = FORMATS[kind](columns, tmp_path / "recorded")
        if kind == "mcap":
            keys = {**keys, "ignore": [*keys.get("ignore", ()), "log_time_s"]}
        judged = bodycheck.judge(path, SCENARIO, column_map=keys)
        measured = {name: value for name, value in judged.items() if isinstance(value, float)}
        shared = set(measured) & set(expected)
        assert len(shared) >= 3
        assert set(measured) - shared <= {"orthogonality_error", "determinant_error", "stamp_spacing_s"}
        for name in shared - NO_QUATERNION - {"truth_bound_rad"}:
            assert measured[name] == pytest.approx(expected[name], rel=1e-12, abs=ABSOLUTE), name
        if way in (as_it_is, other_units, scalar_last, north_east_down):
            assert shared >= NO_QUATERNION
        elif "euler" in keys:
            assert not NO_QUATERNION & shared


@pytest.mark.parametrize("keys", [{"attitude": "world-to-body"}, {"body": "FRD to FLU"}], ids=str)
def test_conventions_also_apply_to_the_arrays_of_an_npz(
    keys: dict[str, Any], motions: list[tuple[Motion, dict[str, Any]]], tmp_path: Path
) -> None:
    """An npz with quaternions (n, 4), as bodycheck writes it, is judged like a file with columns."""
    m, expected = motions[2]
    flip = Rotation.from_matrix(np.diag([1, -1, -1])) if "body" in keys else Rotation.identity()
    rotation = m.rotation * flip.inv()
    if "attitude" in keys:
        rotation = rotation.inv()
    quaternion, omega = rotation.as_quat(scalar_first=True), flip.apply(m.omega_body_rad_s)
    path = tmp_path / "own.npz"
    path.write_bytes(npz({"t_s": m.t_s, "quaternion": quaternion, "omega_body_rad_s": omega}))
    judged = bodycheck.judge(path, SCENARIO, column_map=keys)
    for name in ("orientation_error_rad", "omega_error"):
        assert judged[name] == pytest.approx(expected[name], rel=1e-12, abs=ABSOLUTE), name


@pytest.mark.parametrize("wrong", ["t_s", "qw", "wx_body_rad_s", "x_m"])
def test_a_wrong_factor_is_noticed(
    wrong: str, motions: list[tuple[Motion, dict[str, Any]]], tmp_path: Path
) -> None:
    """The law above fails if one column is scaled wrongly by a thousandth."""
    m, expected = motions[0]
    path = write_csv(m.as_recorded(), tmp_path / "recorded")
    judged = bodycheck.judge(path, SCENARIO, column_map={wrong: f"{wrong}*0.999"})
    measured = {name for name, value in expected.items() if isinstance(value, float)}
    off = {name for name in measured if judged[name] != pytest.approx(expected[name], rel=1e-9)}
    assert off & {"orientation_error_rad", "omega_error", "position_error"}


def nesc_columns(m: Motion) -> dict[str, Array]:
    """Return a motion at longitude and latitude 0 in the columns of NASA's check cases."""
    columns, _ = over_the_earth(m, np.random.default_rng(0))
    names = {
        "t_s": "time",
        "yaw": "eulerAngle_deg_Yaw",
        "pitch": "eulerAngle_deg_Pitch",
        "roll": "eulerAngle_deg_Roll",
        "lon": "longitude_deg",
        "lat": "latitude_deg",
        "wx_body_rad_s": "bodyAngularRateWrtEi_deg_s_Roll",
        "wy_body_rad_s": "bodyAngularRateWrtEi_deg_s_Pitch",
        "wz_body_rad_s": "bodyAngularRateWrtEi_deg_s_Yaw",
    }
    found = {names[name]: np.rad2deg(v) if name.startswith("w") else v for name, v in columns.items()}
    return {**found, "mach": np.zeros(len(m.t_s)), "altitudeMsl_ft": np.full(len(m.t_s), 3e4)}


def test_check_case_of_nesc_needs_one_option(
    motions: list[tuple[Motion, dict[str, Any]]], tmp_path: Path
) -> None:
    """The columns of NASA's check cases are judged as they stand, like the same motion by hand."""
    m, expected = motions[1]
    path = write_csv(nesc_columns(m), tmp_path / "Atmos_02_sim_09")
    judged = bodycheck.judge(path, SCENARIO, like="nesc")
    for name in ("orientation_error_rad", "omega_error", "rotational_energy_drift", "angular_momentum_drift"):
        assert judged[name] == pytest.approx(expected[name], rel=1e-12, abs=ABSOLUTE)


def test_scenario_of_a_check_case_is_known_by_its_name(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """Atmos_02 is the tumbling brick: its exact motion has no error; another file needs --scenario."""
    t_s = np.linspace(0.0, 30.0, 31)
    true = bodycheck.truth("nesc-tumbling-brick", list(t_s)).trajectory
    m = Motion(t_s, true.position_m, true.attitude, true.velocity_m_s, true.omega_body)
    path = write_csv(nesc_columns(m), tmp_path / "Atmos_02_sim_09")
    judged = bodycheck.judge(path, like="nesc")
    assert judged["scenario"] == "nesc-tumbling-brick"
    assert judged["orientation_error_rad"] < 1e-13
    with expected_message.raises(bodycheck.InputError):
        bodycheck.judge(path.rename(tmp_path / "Atmos_03_sim_09.csv"), like="nesc")


def test_topic_of_a_file_without_topics_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """Only MCAP files have topics: the key would be ignored."""
    path = tmp_path / "motion.csv"
    path.write_text("t_s\n0\n")
    with expected_message.raises(bodycheck.InputError):
        bodycheck.judge(path, SCENARIO, column_map="topic=/odom")


def write_json_odometry(path: Path, messages: Sequence[Mapping[str, Any]]) -> None:
    """Write messages of odometry, and of another topic, as JSON in MCAP."""
    writer_module = pytest.importorskip("mcap.writer", reason="MCAP is an optional format")
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start()
        schema = writer.register_schema("nav_msgs/msg/Odometry", "jsonschema", b"{}")
        odometry = writer.register_channel("/odom", "json", schema)
        other = writer.register_channel("/temperature", "json", schema)
        for k, message in enumerate(messages):
            writer.add_message(odometry, k + 7, json.dumps(message).encode(), k + 7)
            writer.add_message(other, k + 8, b'{"celsius": 20}', k + 8)
        writer.finish()


ODOMETRY = """std_msgs/Header header
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
===
MSG: std_msgs/Header
builtin_interfaces/Time stamp
===
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
===
MSG: geometry_msgs/Pose
geometry_msgs/Vector3 position
geometry_msgs/Quaternion orientation
===
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
===
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
===
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
===
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
""".replace("===", "=" * 80)


def write_ros_odometry(path: Path, messages: Sequence[Mapping[str, Any]]) -> None:
    """Write messages of odometry, and of another topic, as ROS 2 records them."""
    writer_module = pytest.importorskip("mcap_ros2.writer", reason="MCAP is an optional format")
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        odometry = writer.register_msgdef("nav_msgs/msg/Odometry", ODOMETRY)
        other = writer.register_msgdef("sensor_msgs/msg/Temperature", "float64 celsius")
        for k, message in enumerate(messages):
            writer.write_message("/odom", odometry, message, k + 7)
            writer.write_message("/temperature", other, {"celsius": 20.0}, k + 8)
        writer.finish()


@pytest.mark.parametrize("write", [write_json_odometry, write_ros_odometry])
def test_odometry_in_mcap_needs_one_option(
    write: Callable[[Path, Sequence[Mapping[str, Any]]], None],
    tmp_path: Path,
    expected_message: ExpectedMessage,
) -> None:
    """A pose and a twist as ROS nests them, with its stamps, are judged as they stand."""
    t_s = np.linspace(0.0, 1.0, 11)
    true = bodycheck.truth(SCENARIO, list(t_s)).trajectory
    velocity = Rotation.from_quat(true.attitude, scalar_first=True).inv().apply(true.velocity_m_s)

    def of(names: str, values: Array) -> dict[str, float]:
        return dict(zip(names, values.tolist(), strict=True))

    messages = []
    for k in range(11):
        stamp = {"sec": 1_700_000_000 + k // 10, "nanosec": (k % 10) * 100_000_000}
        pose = {"position": of("xyz", true.position_m[k]), "orientation": of("wxyz", true.attitude[k])}
        twist = {"linear": of("xyz", velocity[k]), "angular": of("xyz", true.omega_body[k])}
        messages.append({"header": {"stamp": stamp}, "pose": {"pose": pose}, "twist": {"twist": twist}})
    path = tmp_path / "flight.mcap"
    write(path, messages)
    judged = bodycheck.judge(path, SCENARIO, like="mcap", column_map="topic=/odom")
    assert judged["orientation_error_rad"] < 1e-13
    assert judged["position_error"] < 1e-13
    assert judged["velocity_error"] < 1e-13
    with expected_message.raises(bodycheck.InputError):
        bodycheck.judge(path, SCENARIO, like="mcap")


def test_energy_is_compared_with_the_truth_and_with_its_own_start(tmp_path: Path) -> None:
    """A body that spins 10 % too fast throughout conserves its energy, and has 21 % too much of it."""
    t_s = np.linspace(0.0, 1.0, 11)
    true = bodycheck.truth(SCENARIO, list(t_s)).trajectory
    columns = {"t_s": t_s} | dict(zip(COLUMNS["omega_body_rad_s"], 1.1 * true.omega_body.T, strict=True))
    judged = bodycheck.judge(write_csv(columns, tmp_path / "fast"), SCENARIO)
    assert judged["rotational_energy_drift"] == pytest.approx(0.21, rel=1e-12)
    assert judged["rotational_energy_drift_from_start"] < 1e-14


def test_files_are_ranked_and_their_order_is_fitted(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """Errors of 0.1 h^2, in any order of the files, are ranked from the finest, with order 2."""
    t_s = np.linspace(0.0, 1.0, 11)
    true = bodycheck.truth(SCENARIO, list(t_s)).trajectory
    omega = true.omega_body.T
    steps = [0.1, 0.4, 0.05, 0.2, 0.025]
    paths = []
    for dt_s in steps:
        moved = dict(zip(COLUMNS["omega_body_rad_s"], omega + 0.1 * dt_s**2, strict=True))
        paths.append(write_csv({"t_s": t_s} | moved, tmp_path / f"step{1000 * dt_s:.0f}"))
    from bodycheck.runs.runner import rank

    ranking = rank(paths, SCENARIO, steps)
    assert [row["dt_s"] for row in ranking.rows] == sorted(steps)
    assert ranking.quantity == "omega_error"
    order = ranking.orders["omega_error"]
    assert order.verdict == "converges"
    assert order.order == pytest.approx(2.0, abs=0.02)
    with expected_message.raises(bodycheck.InputError):
        rank(paths, SCENARIO, [0.1, 0.2])


def test_trajectory_that_diverged_is_ranked_last(tmp_path: Path) -> None:
    """A file with NaN has no measure and comes after those that have one."""
    t_s = np.linspace(0.0, 1.0, 3)
    true = bodycheck.truth(SCENARIO, list(t_s)).trajectory
    omega = dict(zip(COLUMNS["omega_body_rad_s"], true.omega_body.T, strict=True))
    sound = write_csv({"t_s": t_s} | omega, tmp_path / "sound")
    lost = tmp_path / "lost.csv"
    lost.write_text(sound.read_text().replace(repr(float(true.omega_body[1, 0])), "nan"))
    from bodycheck.runs.runner import rank

    ranking = rank([lost, sound], SCENARIO)
    assert [Path(row["file"]).name for row in ranking.rows] == ["sound.csv", "lost.csv"]
    assert [row["outcome"] for row in ranking.rows] == ["ok", "unstable"]
