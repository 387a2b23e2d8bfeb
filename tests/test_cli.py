"""The command line as a user runs it."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.main import get_command
from typer.testing import CliRunner

import bodycheck
from bodycheck.__main__ import main as bodycheck_main
from bodycheck._util.errors import InputError
from bodycheck.adapters import registry
from bodycheck.cli.commands import app
from bodycheck.reports.document import answer
from bodycheck.reports.run_files.method_words import map_in_words
from bodycheck.reports.run_files.tables import TABLES
from bodycheck.reports.summary.catalogue import catalogue, catalogue_document
from bodycheck.runs.schemas import SCHEMAS
from bodycheck.runs.selection import select
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import SCENARIO

CALLED = (
    SCENARIO
    + """
[[forcing]]
kind = "callable"
function = "loads:f"
"""
)
FAMILY = (
    SCENARIO
    + """
[[sweep]]
key = "body.mass_kg"
values = [1.0, 2.0]
"""
)


def test_an_interrupt_while_the_command_is_imported_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The status is 130, as for any interrupted run, and no traceback of the import is printed."""

    class Interrupted(ModuleType):
        def __getattr__(self, name: str) -> object:
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "bodycheck.cli.commands", Interrupted("bodycheck.cli.commands"))
    with pytest.raises(SystemExit) as ended:
        bodycheck_main()
    assert ended.value.code == 130
    assert capsys.readouterr() == ("", "stopped before anything started\n")


def test_the_version_is_that_of_the_package(tmp_path: Path) -> None:
    """--version prints one line that can be pasted into a bug report."""
    done = run_bodycheck(tmp_path, "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"bodycheck {version('bodycheck')}\n", "")


@pytest.mark.nightly
def test_a_run_leaves_the_files_of_the_contract(tmp_path: Path) -> None:
    """A run in a separate process writes consistent tables, manifest, report and trajectories."""
    (tmp_path / "mine.toml").write_text(SCENARIO)
    words = ["-m", "bodycheck", "run", "mine.toml", "--engine", "reference", "--out", "out"]
    done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "out/report.html"
    out = tmp_path / "out"
    results, methods = pd.read_csv(out / "results.csv"), pd.read_csv(out / "methods.csv")
    assert tuple(results.columns) == TABLES["results"].columns
    assert tuple(methods.columns) == TABLES["methods"].columns
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["run_id"] == results["run_id"].unique().item()
    assert manifest["outcomes"] == results["outcome"].value_counts().to_dict()
    assert sum(1 for _ in out.glob("trajectories/mine/*.npz")) == len(results) + 1
    with np.load(out / "trajectories/mine/reference_rk4_0.01.npz", allow_pickle=False) as arrays:
        assert arrays["quaternion"].shape == (11, 4)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.toml", "out"]


@pytest.mark.slow
def test_the_reproducing_command_reproduces_the_case(tmp_path: Path) -> None:
    """The command in a row of results.csv gives the same row again, digit for digit, except for its times."""
    (tmp_path / "mine.toml").write_text(SCENARIO)
    requested = ("run", "mine.toml", "--engine", "reference:m2,reference:exact", "--no-speed")
    assert run_bodycheck(tmp_path, *requested, "--out", "a").returncode == 0
    with (tmp_path / "a/results.csv").open() as file:
        rows = list(csv.DictReader(file))
    row = next(row for row in rows if row["dt_s"] == "0.005")
    words = row["reproduce"].split()
    assert words[0] == "bodycheck"
    assert run_bodycheck(tmp_path, *words[1:], "--out", "b").returncode == 0
    with (tmp_path / "b/results.csv").open() as file:
        again = next(csv.DictReader(file))
    timed = {
        "run_id",
        "cpu_s",
        "cpu_s_low",
        "cpu_s_high",
        "ns_per_step",
        "relative_cpu",
        "successive_difference_rad",
    }
    assert {k: v for k, v in row.items() if k not in timed} == {
        k: v for k, v in again.items() if k not in timed
    }


WRONG = {
    "unknown scenario": ["run", "nope"],
    "wrong file": ["run", "bad.toml"],
    "unknown engine": ["run", "mine.toml", "--engine", "havok"],
    "unknown method": ["run", "mine.toml", "--engine", "reference:rk5"],
    "no engine at all": ["run", "mine.toml", "--engine", ""],
    "no method at all": ["run", "mine.toml", "--engine", "reference:"],
    "a step twice": ["run", "mine.toml", "--dt", "0.1,0.05,0.1"],
    "here": ["run", "mine.toml", "--out", "."],
    "step that does not fit": ["run", "mine.toml", "--dt", "0.03"],
    "step that is no number": ["run", "mine.toml", "--dt", "fast"],
    "zero step": ["run", "mine.toml", "--dt", "0"],
    "infinite step": ["run", "mine.toml", "--dt", "inf"],
    "no strand": ["run", "mine.toml", "--jobs", "0"],
    "fewer than none": ["run", "mine.toml", "--jobs", "-3"],
    "jobs that are no number": ["run", "mine.toml", "--jobs", "many"],
    "no time": ["run", "mine.toml", "--timeout-s", "0"],
    "time backwards": ["run", "mine.toml", "--timeout-s", "-1"],
    "no end": ["run", "mine.toml", "--timeout-s", "inf"],
    "time that is none": ["run", "mine.toml", "--timeout-s", "nan"],
    "soon": ["run", "mine.toml", "--timeout-s", "soon"],
    "nothing to resume": ["run", "--resume", "nothing"],
    "resumed otherwise": ["run", "--resume", "x", "--dt", "0.1"],
    "output in use": ["run", "mine.toml", "--out", "used"],
    "output is a file": ["run", "mine.toml", "--out", "mine.toml"],
    "truth at a negative time": ["truth", "mine.toml", "--at", "0,-1"],
    "truth at no time": ["truth", "mine.toml", "--at", "nan"],
    "truth of nothing": ["truth", "nope", "--at", "0"],
    "no mesh": ["body", "no.stl", "--density-kg-m3", "1"],
    "no solid": ["body", "mine.toml", "--density-kg-m3", "1"],
    "no density": ["body", "sphere", "--size-m", "1", "--density-kg-m3", "0"],
    "no sizes": ["body", "sphere", "--density-kg-m3", "1"],
    "sizes in words": ["body", "sphere", "--size-m", "big", "--density-kg-m3", "1"],
    "code not allowed": ["body", "mine:f", "--box-m", "-1,-1,-1,1,1,1", "--density-kg-m3", "1"],
    "family for one scenario": ["truth", "family.toml", "--at", "0"],
    "function not allowed": ["run", "called.toml"],
    "function that fails": ["truth", "called.toml", "--at", "0,1", "--allow-code"],
    "function that gives NaN": ["truth", "nan.toml", "--at", "0,1", "--allow-code"],
    "judged file that is none": ["judge", "no.csv", "--scenario", "mine.toml"],
    "unknown list": ["list", "colours"],
    "unknown option": ["run", "--fast"],
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_input_ends_with_status_2_and_one_clear_line(
    what: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The message names the error and its place; no traceback, no file and no standard output is produced."""
    (tmp_path / "mine.toml").write_text(SCENARIO)
    (tmp_path / "bad.toml").write_text(SCENARIO.replace("1.0\nsam", "-1.0\nsam"))
    (tmp_path / "called.toml").write_text(CALLED)
    (tmp_path / "family.toml").write_text(FAMILY)
    (tmp_path / "nan.toml").write_text(CALLED.replace("loads:f", "loads:nan"))
    functions = "def f(*_):\n    return 1 / 0\n\n\ndef nan(*_):\n    return 3 * [float('nan')], 3 * [0.0]\n"
    (tmp_path / "loads.py").write_text(functions)
    (tmp_path / "used").mkdir()
    (tmp_path / "used/file").touch()
    before = sorted(path.name for path in tmp_path.iterdir())
    done = run_bodycheck(tmp_path, *WRONG[what])
    assert (done.returncode, done.stdout) == (2, "")
    expected_message(done.stderr.strip())
    left = sorted(path.name for path in tmp_path.iterdir() if path.name != "__pycache__")
    assert left == before


UNUSED = [
    ("audit --spellings --no-spins", "--no-spins"),
    ("audit --spellings --fail-on error", "--fail-on"),
    ("audit mine.toml --lint --engine mujoco", "--engine"),
    ("audit mine.toml --lint --shard 1/2 --out x", "--shard"),
    ("audit mine.toml --no-spins --shard 1/2 --out x", "--shard"),
    ("ensemble mine.toml --row 1 --first-row 0", "--first-row"),
    ("ensemble mine.toml --row 1 --jobs 2", "--jobs"),
    ("gate standard --gates t.toml --run used", "SCENARIOS"),
    ("gate --gates t.toml --run used --reuse", "--reuse"),
    ("gate --gates t.toml --run used --out x", "--out"),
    ("merge used --out x --threshold 0.1", "--threshold"),
    ("nightly mine.toml --shard 1/2 --out x --json", "--json"),
    ("nightly mine.toml --shard 1/2 --out x --history h", "--history"),
    ("report used --markdown m.md --allow-code", "--allow-code"),
    ("run standard --resume x", "SCENARIOS"),
    ("run --resume x --timeout-s 120", "--timeout-s"),
    ("versions mujoco --since 3.6 --audit mine.toml --dt x", "--dt"),
]


@pytest.mark.parametrize(("words", "option"), UNUSED)
def test_options_that_would_be_ignored_are_refused(
    words: str, option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the value is the default, because it was given."""
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, words.split())
    assert isinstance(done.exception, InputError)
    assert str(done.exception).endswith(f"; {option} does not apply")
    assert not list(tmp_path.iterdir())


TIMED = [
    "check-adapter reference",
    "fingerprint reference:rk4",
    "hunt mine.toml --engine reference:rk4",
    "laws reference:rk4",
    "audit mine.toml",
]


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf"])
@pytest.mark.parametrize("command", TIMED)
def test_time_limit_is_a_positive_number_in_every_command(command: str, seconds: str) -> None:
    """Otherwise every case would count as a timeout, and an engine as broken."""
    done = CliRunner().invoke(app, [*command.split(), "--timeout-s", seconds])
    assert isinstance(done.exception, InputError)
    assert str(done.exception).startswith("--timeout-s")


def test_truth_is_printed_as_csv_with_its_bound(tmp_path: Path) -> None:
    """Columns are those of a trajectory CSV plus bound_rad; times are as requested, and values are exact."""
    done = run_bodycheck(tmp_path, "truth", "intermediate-axis", "--at", "10,0,1")
    assert done.returncode == 0, done.stderr
    rows = list(csv.reader(done.stdout.splitlines()))
    assert rows[0][:5] == ["t_s", "x_m", "y_m", "z_m", "qw"]
    assert rows[0][-1] == "bound_rad"
    assert [row[0] for row in rows[1:]] == ["10.0", "0.0", "1.0"]
    solved = bodycheck.truth("intermediate-axis", [10.0, 0.0, 1.0])
    assert [float(row[4]) for row in rows[1:]] == solved.trajectory.attitude[:, 0].tolist()


def test_a_body_is_printed_as_toml_at_full_precision(tmp_path: Path) -> None:
    """A unit cube of density 6 kg/m^3 has a mass of 6 kg and principal moments of exactly 1 kg m^2."""
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c} {d}" for a, b, c, d in quads]
    (tmp_path / "cube.obj").write_text("\n".join(lines) + "\n")
    done = run_bodycheck(tmp_path, "body", "cube.obj", "--density-kg-m3", "6")
    assert done.returncode == 0, done.stderr
    found = tomllib.loads(done.stdout)
    assert found["body"]["mass_kg"] == 6.0
    assert found["solid"]["centre_m"] == [0.5, 0.5, 0.5]
    assert found["solid"]["principal_moments_kg_m2"] == pytest.approx([1.0, 1.0, 1.0], rel=1e-15, abs=0.0)


@pytest.mark.slow
def test_a_shape_and_a_users_function_are_bodies_too(tmp_path: Path) -> None:
    """A ball as a shape and as a user's level set has the same mass, within the latter's standard error."""
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n\n\ndef ball(p):\n    return np.linalg.norm(p, axis=1) - 0.5\n"
    )
    size, box = ("--size-m", "0.5"), ("--box-m", "-1,-1,-1,1,1,1")
    shape = run_bodycheck(tmp_path, "body", "sphere", *size, "--density-kg-m3", "6")
    level_set = run_bodycheck(tmp_path, "body", "mine:ball", *box, "--density-kg-m3", "6", "--allow-code")
    assert shape.returncode == level_set.returncode == 0, shape.stderr + level_set.stderr
    exact, found = tomllib.loads(shape.stdout), tomllib.loads(level_set.stdout)
    assert exact["body"]["mass_kg"] == pytest.approx(np.pi, rel=1e-15, abs=0.0)
    assert "estimated" in level_set.stdout.splitlines()[0]
    off = abs(found["body"]["mass_kg"] - exact["body"]["mass_kg"])
    assert 0.0 < off < 4.0 * found["solid"]["mass_standard_error_kg"] < 0.01


@pytest.mark.nightly
def test_a_users_load_has_a_truth_and_is_judged_by_it(tmp_path: Path) -> None:
    """Drag as a callback load moves like built-in drag, in the truth and in every method that supports it."""
    (tmp_path / "called.toml").write_text(CALLED)
    (tmp_path / "loads.py").write_text("def f(t, x, r, v, omega):\n    return -0.5 * v, -0.2 * omega\n")
    drag = '[[forcing]]\nkind = "drag"\nlinear_n_s_m = 0.5\nangular_n_m_s = 0.2\n'
    (tmp_path / "drag.toml").write_text(SCENARIO + drag)
    times, allowed = ("--at", "0,0.5,1"), "--allow-code"
    called = run_bodycheck(tmp_path, "truth", "called.toml", *times, allowed)
    written = run_bodycheck(tmp_path, "truth", "drag.toml", *times)
    assert called.returncode == written.returncode == 0, called.stderr + written.stderr
    one, other = (
        np.loadtxt(done.stdout.splitlines(), delimiter=",", skiprows=1) for done in (called, written)
    )
    assert np.max(np.abs(one - other)) <= 1e-12
    (tmp_path / "drag.csv").write_text(written.stdout)
    judged = run_bodycheck(tmp_path, "judge", "drag.csv", "--scenario", "called.toml", allowed)
    assert judged.returncode == 0, judged.stderr
    measures = dict(line.split(maxsplit=1) for line in judged.stdout.splitlines() if len(line.split()) > 1)
    assert measures["truth"] == "certified"
    assert float(measures["orientation_error_rad"]) <= 1e-12
    run = run_bodycheck(
        tmp_path,
        "run",
        "called.toml",
        "--engine",
        "reference:taylor,reference:rk4,reference:m1",
        "--dt",
        "0.02,0.01",
        "--no-speed",
        allowed,
        "--out",
        "out",
    )
    assert run.returncode == 0, run.stderr
    results = pd.read_csv(tmp_path / "out/results.csv")
    assert results["reproduce"].str.endswith("--allow-code").all()
    outcomes = results.groupby("method")["outcome"].unique()
    assert outcomes.map(list).to_dict() == {"taylor": ["unsupported"], "rk4": ["ok"], "m1": ["ok"]}
    errors = results.set_index(["method", "dt_s"])["orientation_error_rad"]
    assert errors["rk4", 0.01] < 1e-8 < errors["m1", 0.01] < 0.6 * errors["m1", 0.02]


@pytest.mark.nightly
def test_a_function_that_fails_in_an_engine_is_shown(tmp_path: Path) -> None:
    """A run ends with status 0 if a function fails in an engine's process, and the case states the reason."""
    (tmp_path / "called.toml").write_text(CALLED)
    (tmp_path / "loads.py").write_text(
        "import os\n\n\ndef f(t, x, r, v, omega):\n"
        "    return -0.5 * v, -0.2 * omega + 0.0 * ('BODYCHECK_RUN_PID' not in os.environ or 1 / 0)\n"
    )
    run = run_bodycheck(
        tmp_path,
        *("run", "called.toml", "--engine", "reference:m1", "--dt", "0.02", "--no-speed", "--allow-code"),
        *("--out", "out"),
    )
    assert run.returncode == 0, run.stderr
    results = pd.read_csv(tmp_path / "out/results.csv")
    assert results["outcome"].tolist() == ["failed"]
    assert "loads:f: failed at t = 0.0 s: ZeroDivisionError" in results["message"][0]


@pytest.mark.nightly
def test_a_child_of_a_family_runs_and_reproduces(tmp_path: Path) -> None:
    """Each child of a family has its own row, whose command runs that child alone."""
    (tmp_path / "family.toml").write_text(FAMILY)
    done = run_bodycheck(
        tmp_path, "run", "family.toml", "--engine", "reference:exact", "--no-speed", "--out", "out"
    )
    assert done.returncode == 0, done.stderr
    results = pd.read_csv(tmp_path / "out/results.csv")
    assert results["scenario"].tolist() == ["mine/1.0", "mine/2.0"]
    assert set(results["family"]) == {"mine"}
    words = results["reproduce"][1].split()[1:]
    again = run_bodycheck(tmp_path, *words, "--no-speed", "--out", "again")
    assert again.returncode == 0, again.stderr
    assert pd.read_csv(tmp_path / "again/results.csv")["scenario"].tolist() == ["mine/2.0"]


def test_what_was_put_right_in_a_mesh_reaches_the_user(tmp_path: Path) -> None:
    """The note on an inside-out mesh appears on the terminal, in the report and in the manifest."""
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    (tmp_path / "part.obj").write_text(corners + "f 1 2 3\nf 1 4 2\nf 2 4 3\nf 1 3 4\n")
    numbers = "mass_kg = 1.0\ninertia_kg_m2 = [1.0, 2.0, 2.5]\n"
    (tmp_path / "mine.toml").write_text(
        SCENARIO.replace(numbers, 'mesh = "part.obj"\ndensity_kg_m3 = 600.0\n')
    )
    words = ("run", "mine.toml", "--engine", "reference:m1", "--dt", "0.01", "--no-speed", "--out", "out")
    done = run_bodycheck(tmp_path, *words)
    assert done.returncode == 0, done.stderr
    note = "the mesh was inside-out; all its triangles were reversed"
    assert f"mine: {note}" in " ".join(done.stdout.split())
    assert f"mesh part.obj, 600 kg/m³; {note}" in (tmp_path / "out/report.html").read_text()
    body = json.loads((tmp_path / "out/manifest.json").read_text())["scenarios"]["mine"]["body"]
    assert body["notes"] == [note]
    assert body["mass_kg"] == pytest.approx(100.0, rel=1e-15, abs=0.0)


@pytest.mark.slow(after=2)
@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("scenarios", "near-separatrix"),
        ("suites", "standard"),
        ("engines", "reference"),
        ("methods", "reference:lie-euler"),
        ("measures", "orientation_error_rad"),
    ],
)
def test_list_names_what_there_is(what: str, expected: str, tmp_path: Path) -> None:
    """Each catalogue has a line that begins with the expected name."""
    done = run_bodycheck(tmp_path, "list", what)
    assert done.returncode == 0, done.stderr
    assert any(line.startswith(expected) for line in done.stdout.splitlines())


def test_list_says_of_methods_what_they_share_once(capsys: pytest.CaptureFixture[str]) -> None:
    """No formula of a map and no description of an engine's methods is printed twice."""
    entries = catalogue("methods", ["mujoco"])
    answer(catalogue_document("methods", entries), entries, as_json=False)
    text = capsys.readouterr().out
    assert len({entry.map for entry in entries}) == 3
    for entry in entries:
        assert text.count(entry.formula) == 1
        assert text.count(f" {entry.description}\n") == 1
    assert "as mujoco:implicit\n" in text


def plug_in(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, place: str) -> None:
    """Install a package that offers an engine into the folder, which is added to this process's path."""
    facts = folder / f"{name}-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(f"[bodycheck.adapters]\n{name} = {place}\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(registry, "_plugged_in", registry._plugged_in.__wrapped__)


@pytest.mark.nightly
def test_an_engine_that_cannot_be_imported_is_shown_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The manifest and the report list a missing engine; requesting it by name is an error."""
    plug_in(tmp_path, monkeypatch, "ghost", "bodycheck_no_such_module:Ghost")
    path = tmp_path / "mine.toml"
    path.write_text(SCENARIO)
    measured = bodycheck.run([path], dt_s=[0.01], speed=False)
    reason = measured.manifest["engines"]["ghost"]["unavailable"]
    assert "No module named 'bodycheck_no_such_module'" in reason
    assert "bodycheck_no_such_module" in bodycheck.write_run(measured, tmp_path / "out").read_text()
    with expected_message.raises(bodycheck.InputError):
        bodycheck.run([path], engines=["ghost"])


@pytest.mark.slow
def test_a_torque_that_switches_inside_a_step_is_said_so(tmp_path: Path) -> None:
    """Such a step applies the mean torque, and the message of the row states it."""
    path = tmp_path / "mine.toml"
    path.write_text(
        SCENARIO + '[[forcing]]\nkind = "torque"\naxes = "body"\nvalue_n_m = [1, 0, 0]\nuntil_s = 0.105\n'
    )
    measured = bodycheck.run([path], engines=["reference:rk4"], dt_s=[0.01, 0.005], speed=False)
    assert measured.results["message"].tolist() == [
        "load switches inside a step: 1; such a step applies the mean of its loads",
        "",
    ]
    assert measured.results["orientation_error_rad"].tolist()[1] < 1e-9


def test_untouched_defaults_are_run_only_when_named() -> None:
    """An engine's name selects all methods except the @defaults variants, which are requested by name."""
    pytest.importorskip("pybullet")
    names = [method.name for _, method in select(["smoke"], ["pybullet"]).methods]
    assert names == ["multibody", "maximal"]
    named = [method.name for _, method in select(["smoke"], ["pybullet:multibody@defaults"]).methods]
    assert named == ["multibody@defaults"]


@pytest.mark.slow
def test_a_run_without_speed_measures_no_time(tmp_path: Path) -> None:
    """Without speed the columns of speed are empty, and the errors are still measured."""
    path = tmp_path / "mine.toml"
    path.write_text(SCENARIO)
    measured = bodycheck.run([path], engines=["reference:m1"], dt_s=[0.01], speed=False)
    assert measured.results[["cpu_s", "ns_per_step"]].isna().all(axis=None)
    assert measured.results["orientation_error_rad"].notna().all()


@pytest.mark.slow
def test_the_map_of_each_method_is_printed(tmp_path: Path) -> None:
    """The table has the rows of --json, and a known map has its formula below the table."""
    words = ("fingerprint", "pybullet:multibody,reference:rk4", "--quiet")
    printed, rows = (run_bodycheck(tmp_path, *words, *more) for more in ((), ("--json",)))
    assert printed.returncode == rows.returncode == 0, printed.stderr + rows.stderr
    found = {row["method"]: row["fingerprint"] for row in json.loads(rows.stdout)}
    assert found == {"multibody": "M1, step angle at most pi/4", "rk4": "RK4, additive quaternion"}
    assert printed.stdout.splitlines()[0] == "2 of 2 methods with a known map"
    for row in json.loads(rows.stdout):
        assert row["agreement"] < 1e-14 < 1e-5 < row["runner_up_distance"]
        assert f"{map_in_words(row['fingerprint'])}: {row['description']}" in printed.stdout.splitlines()


@pytest.mark.nightly
def test_a_broken_law_is_printed_with_its_size_and_ends_with_status_1(tmp_path: Path) -> None:
    """PyBullet's defaults, damping of 0.04 / s among them, break five laws; without them all laws hold."""
    words = ("laws", "pybullet:multibody@defaults,pybullet:multibody", "--quiet")
    printed, rows = (run_bodycheck(tmp_path, *words, *more) for more in ((), ("--json",)))
    assert printed.returncode == rows.returncode == 1, printed.stderr + rows.stderr
    broken = {(row["method"], row["law"]) for row in json.loads(rows.stdout) if row["verdict"] == "broken"}
    laws = ("boost", "scale-time", "tree-boost", "tree-divide", "tree-order")
    assert broken == {("multibody@defaults", law) for law in laws}
    assert printed.stdout.startswith("5 laws broken: boost by pybullet:multibody@defaults, ")
    sound = run_bodycheck(tmp_path, "laws", "reference:rk4", "--quiet")
    assert sound.returncode == 0
    assert sound.stdout.startswith("reference:rk4: no law is broken, ")


def every_option() -> list[Any]:
    """Return the options of all commands."""
    root: Any = get_command(app)
    groups = [root, *(one for one in root.commands.values() if hasattr(one, "commands"))]
    return [
        one
        for group in groups
        for command in group.commands.values()
        for one in command.params
        if one.opts[0].startswith("-")
    ]


def test_an_option_has_one_meaning_in_all_commands() -> None:
    """--out is a folder; an option that takes a FILE to write is named by the format of the file."""
    found = every_option()
    folders = [one.help for one in found if one.opts[0] == "--out"]
    assert len(folders) > 5
    assert all("older" in text for text in folders), folders
    kinds: dict[str, set[str]] = {}
    for one in found:
        if str(one.help).startswith("Write"):
            kinds.setdefault(one.opts[0], set()).add(f"{one.metavar} {one.multiple}")
    formats = ("html", "markdown", "junit", "sarif", "svg", "pdf", "png", "gif", "mp4", "parquet")
    assert {f"--{name}" for name in formats} <= kinds.keys()
    assert all(kinds[f"--{name}"] == {"FILE False"} for name in formats)


@pytest.mark.parametrize(
    "words",
    [
        "gate --tolerances t.toml",
        "compare a b --thresholdz t.toml",
        "advise --quantity omega_error",
        "history list --history nights",
    ],
)
def test_an_unknown_option_gets_the_nearest_or_all(words: str, expected_message: ExpectedMessage) -> None:
    """One that resembles an option or an argument is corrected; else all options are listed."""
    done = run_bodycheck(Path(), *words.split())
    assert (done.returncode, done.stdout) == (2, "")
    expected_message(done.stderr.strip())


@pytest.mark.parametrize("command", ["history", "environments", "schema"])
def test_a_command_without_its_first_word_lists_the_words_one_a_line(
    command: str, expected_message: ExpectedMessage
) -> None:
    """The status is 2; each line has a word and what it stands for."""
    done = run_bodycheck(Path(), command)
    assert (done.returncode, done.stdout) == (2, "")
    first, *lines = done.stderr.splitlines()
    expected_message(first)
    group: Any = get_command(app)
    names = [*SCHEMAS] if command == "schema" else [*group.commands[command].commands]
    shown = {words[0]: words[1:] for line in lines if (words := line.split())}
    assert all(len(shown[name]) > 1 for name in names)
