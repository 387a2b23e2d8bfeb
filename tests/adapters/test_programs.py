"""Programs in any language take part in a run like the built-in engines."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import bodycheck
from bodycheck._util.errors import InputError
from bodycheck.adapters.engine_names import admit, admit_file, pin_of, split_method, with_method
from bodycheck.adapters.registry import program_of, registered, requested_name
from bodycheck.adapters.workers.engine_pool import announced
from bodycheck.examine.probes.adapter_checks import CHECKS
from bodycheck.reports.comparison.compare import paired_versions, renamed
from bodycheck.reports.gates.gate import Gate
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import check_engines
from bodycheck.runs.engine_checks import check_adapter
from bodycheck.runs.selection import select
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import tumbling

WORKERS = Path(__file__).parents[2] / "docs/workers"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield the working directory, which contains a scenario; remove engines that the test registered."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(tumbling())
    with registered():
        yield tmp_path


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("mujoco", ("mujoco", "", "")),
        ("mujoco:rk4", ("mujoco", ":", "rk4")),
        ("mujoco == 3.6.0:rk4", ("mujoco==3.6.0", ":", "rk4")),
        ("cmd:./worker --port=1:2", ("cmd:./worker --port=1:2", "", "")),
        ("cmd:./worker a==b::rk4", ("cmd:./worker a==b", "::", "rk4")),
    ],
)
def test_engine_and_method_are_split_where_the_method_begins(name: str, parts: tuple[str, str, str]) -> None:
    """A command may contain colons and equals signs, and its method follows two colons."""
    assert split_method(name) == parts
    engine, _, method = parts
    if method:
        assert split_method(with_method(engine, method)) == parts


def test_command_is_not_a_pin() -> None:
    """Two equals signs in a command line do not specify a version of an engine."""
    assert pin_of("cmd:./worker a==b") is None


FILES = (
    "engines = 1",
    "[engines.a]",
    "[engines.a]\ncommand = []",
    "[engines.a]\ncommand = ['x']\ncolour = 1",
    "[engines.mujoco]\ncommand = ['x']",
    "[engines.'a b']\ncommand = ['x']",
    "[engines",
)


@pytest.mark.parametrize("text", FILES)
def test_wrong_file_of_engines_is_refused_in_one_line(
    text: str, folder: Path, expected_message: ExpectedMessage
) -> None:
    """The error is one line with the file and the key."""
    (folder / "engines.toml").write_text(text)
    with expected_message.raises(InputError) as refused:
        admit_file(Path("engines.toml"), allow_code=True)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "name",
    [
        "cmd:",
        "cmd:'open",
        "cmd:./no-such-program",
        "nothing",
    ],
)
def test_program_that_does_not_exist_is_refused_before_anything_runs(
    name: str, expected_message: ExpectedMessage
) -> None:
    """The error names the program."""
    with expected_message.raises(InputError):
        bodycheck.run(["mine.toml"], engines=[name])


def _javascript() -> str:
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    return f"cmd:node {WORKERS / 'm1.mjs'}"


def _compiled(folder: Path) -> str:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler is installed")
    command = ["cc", "-O2", "-o", str(folder / "euler"), str(WORKERS / "euler.c"), "-lm"]
    subprocess.run(command, check=True)
    return "cmd:./euler"


@pytest.mark.slow
def test_worker_in_javascript_makes_the_steps_of_the_reference(folder: Path) -> None:
    """The map M1 in JavaScript and in the reference agree to round-off, under gravity and a full tensor."""
    del folder
    run = bodycheck.run(
        ["full-tensor", "boxes"], engines=[_javascript(), "reference:m1"], dt_s=[1e-3], speed=False
    )
    motions = {(c.columns["scenario"], c.columns["engine"] == "reference"): c.trajectory for c in run.cases}
    assert {case.columns["outcome"] for case in run.cases} == {"ok"}
    for scenario in ("full-tensor", "boxes"):
        one, other = motions[scenario, False], motions[scenario, True]
        assert one is not None
        assert other is not None
        np.testing.assert_allclose(one.attitude, other.attitude, rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(one.position_m, other.position_m, rtol=0.0, atol=1e-11)


@pytest.mark.nightly
def test_programs_and_built_in_engines_share_a_run(folder: Path) -> None:
    """Workers in C and JavaScript are measured, timed and judged next to the reference, in one table."""
    run = bodycheck.run(
        ["full-tensor"],
        engines=[_compiled(folder), _javascript(), "reference:m1"],
        dt_s=[4e-3, 2e-3, 1e-3, 5e-4],
    )
    assert set(run.results["outcome"]) == {"ok"}
    assert (run.results["cpu_s"] > 0.0).all()
    orders = run.methods[run.methods["quantity"] == "orientation_error_rad"]
    np.testing.assert_allclose(orders["order"], 1.0, atol=0.1)
    command = run.results["reproduce"][0]
    assert "--engine cmd:./euler::euler" in command


REFUSED_BY_A_SKELETON = {"loads", "link", "continuous loads", "pivot"}


def _passed_checks(program: str) -> set[str]:
    """Return the names of the checks that a program passes; none may fail."""
    admit([program], allow_code=True)
    found = check_adapter(program, timeout_s=60.0)
    assert [(result.check, result.message) for result in found.failures] == []
    return {result.check for result in found.results if result.verdict == "consistent"}


@pytest.mark.nightly
@pytest.mark.parametrize(("language", "compiler"), [("c", "cc"), ("rust", "cargo")])
def test_new_adapter_in_another_language_is_built_and_passes(
    language: str, compiler: str, folder: Path
) -> None:
    """Fewer than 120 lines, built by the printed command, pass all checks that they do not refuse.

    The steps are those of the same map in the reference.
    """
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    made = run_bodycheck(folder, "new-adapter", "my-engine", "--language", language, "--json")
    assert made.returncode == 0, made.stderr
    answer = json.loads(made.stdout)
    written = [path for path in Path(answer["folder"]).rglob("*") if path.is_file()]
    assert sum(len(path.read_text().splitlines()) for path in written) < 120
    build, check = answer["commands"]
    subprocess.run(shlex.split(build), check=True, capture_output=True)
    program = check.removeprefix("bodycheck check-adapter ")
    assert _passed_checks(program) == {check.name for check in CHECKS} - REFUSED_BY_A_SKELETON
    run = bodycheck.run(
        ["full-tensor", "boxes", "thruster"],
        engines=[program, "reference:quaternion-euler"],
        dt_s=[2e-3],
        speed=False,
    )
    rows = [case.columns for case in run.cases]
    outcomes = {(row["scenario"], row["engine"]): row["outcome"] for row in rows}
    assert outcomes.pop(("thruster", "my-engine")) == "unsupported"
    assert set(outcomes.values()) == {"ok"}
    for scenario in ("full-tensor", "boxes"):
        one, other = (case.trajectory for case in run.cases if case.columns["scenario"] == scenario)
        assert one is not None
        assert other is not None
        for name in ("quaternion", "position_m", "omega_body_rad_s"):  # later, round-off has grown
            mine, expected = getattr(one, name)[:30], getattr(other, name)[:30]
            np.testing.assert_allclose(mine, expected, rtol=0.0, atol=1e-11)


@pytest.mark.slow
def test_workers_of_the_docs_pass_the_checks_of_adapters(folder: Path) -> None:
    """The examples in C and JavaScript pass every check of what they do not refuse."""
    for program in (_compiled(folder), _javascript()):
        assert _passed_checks(program) == {check.name for check in CHECKS} - REFUSED_BY_A_SKELETON


ANNOUNCED = """
import json, sys
method = dict(name="m", formula="", order=1, evaluations=1, torque="", conserves="", source="", control="dt",
              changed_defaults=[], tolerances=[])
limits = dict(message_bytes=10**6)
print(json.dumps(dict(bodycheck=1, engine=sys.argv[1], version="1", methods=[method], limits=limits, build="",
                      kind="plug-in")), flush=True)
for line in sys.stdin:
    print(json.dumps(dict(id=json.loads(line)["id"], outcome="unsupported", message="nothing")), flush=True)
"""


def test_a_program_has_the_name_that_it_announces(folder: Path) -> None:
    """Tables have the name, commands the command, gates either; also once the run is read from its files."""
    (folder / "worker.py").write_text(ANNOUNCED)
    program = f"cmd:{sys.executable} worker.py own-engine"
    run = bodycheck.run(["mine.toml"], engines=[program], dt_s=[0.02], speed=False, laws=False)
    bodycheck.write_run(run, folder / "out")
    assert list(run.results["engine"]) == ["own-engine"]
    assert set(run.manifest["engines"]) == {"own-engine"}
    assert f"'{program}::m'" in run.results["reproduce"][0]
    assert program_of("own-engine") is not None
    for pattern in ("own-*", program):
        gate = Gate(engine=pattern, measure="energy_drift", upper=1.0, reason="-")
        assert gate.matches_engine("own-engine")


def test_a_stored_run_knows_the_command_and_starts_nothing(folder: Path) -> None:
    """The command of a program is read from the files of a run, by which it cannot be started."""
    (folder / "worker.py").write_text(ANNOUNCED)
    program = f"cmd:{sys.executable} worker.py own-engine"
    with registered():
        run = bodycheck.run(["mine.toml"], engines=[program], dt_s=[0.02], speed=False, laws=False)
        bodycheck.write_run(run, folder / "out")
    assert requested_name("own-engine") == "own-engine"
    tables = read_tables(folder / "out")
    assert requested_name("own-engine") == program
    assert program_of("own-engine") is None
    check_engines(tables, [program, f"{program}::m", "own-engine", "own-engine:m"])  # as --engine names them


@pytest.mark.parametrize("names", [("own", "own"), ("mujoco", "own"), ("two words", "own")])
def test_a_name_that_is_not_its_own_stays_the_command(names: tuple[str, str], folder: Path) -> None:
    """Programs that announce one name, another engine's, or no short one are shown by their commands."""
    (folder / "worker.py").write_text(ANNOUNCED)
    programs = [f"cmd:{sys.executable} worker.py '{name}' {number}" for number, name in enumerate(names)]
    admit(programs, allow_code=True)
    found = announced(programs)
    shown = [found[program].name for program in programs]  # type: ignore[union-attr]
    assert shown[0] == programs[0]
    assert shown[1] == (programs[1] if names[0] == names[1] else "own")


def test_runs_of_earlier_versions_are_compared_under_the_announced_name(folder: Path) -> None:
    """A run that has the command of a program as its name is paired with one that has the announced name."""
    (folder / "worker.py").write_text(ANNOUNCED)
    program = f"cmd:{sys.executable} worker.py own-engine"
    new = bodycheck.run(["mine.toml"], engines=[program], dt_s=[0.02], speed=False, laws=False)
    before, after = paired_versions(renamed(new, {"own-engine": program}), new)
    assert [case.columns["engine"] for case in (*before.cases, *after.cases)] == ["own-engine"] * 2


FAULTS = {
    "prints rubbish": "print('hello')",
    "ends at once": "raise SystemExit(3)",
    "speaks another version": "print('{\"bodycheck\": 99}', flush=True); input()",
}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("fault", FAULTS)
def test_program_that_does_not_announce_itself_costs_its_own_cases(fault: str, folder: Path) -> None:
    """The other engines are measured and the manifest has the reason; requested alone it is an error."""
    (folder / "worker.py").write_text(FAULTS[fault])
    program = f"cmd:{sys.executable} worker.py"
    with pytest.warns(UserWarning, match="^not measured: "):
        run = bodycheck.run(
            ["mine.toml"], engines=[program, "reference:m1"], dt_s=[0.02], speed=False, laws=False
        )
    assert list(run.results["engine"]) == ["reference"]
    assert program in run.manifest["engines"][program]["unavailable"]
    with pytest.raises(InputError, match=r"worker\.py"):
        bodycheck.run(["mine.toml"], engines=[program])


DYING = """
import json, sys, time
method = dict(name="m", formula="", order=1, evaluations=1, torque="", conserves="", source="", control="dt",
              changed_defaults=[], tolerances=[])
limits = dict(message_bytes=10**6)
print(json.dumps(dict(bodycheck=1, engine="x", version="1", methods=[method], limits=limits, build="b",
                      kind="installed")), flush=True)
input()
{}
"""


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("end", "outcome"),
    [
        ("sys.exit(1)", "failed"),
        ("print('x', flush=True)", "failed"),
        pytest.param("time.sleep(99)", "timeout", marks=pytest.mark.nightly),
    ],
)
def test_program_that_ends_in_a_case_costs_that_case(end: str, outcome: str, folder: Path) -> None:
    """The case has its own outcome, and the program's claim to be an installed release is ignored."""
    (folder / "worker.py").write_text(DYING.format(end))
    (folder / "engines.toml").write_text(f"[engines.x]\ncommand = ['{sys.executable}', 'worker.py']\n")
    run = bodycheck.run(
        ["mine.toml"],
        engines=["x", "reference:m1"],
        dt_s=[0.02],
        speed=False,
        timeout_s=5.0,
        engines_file="engines.toml",
        allow_code=True,
    )
    outcomes = dict(zip(run.results["engine"], run.results["outcome"], strict=True))
    assert outcomes == {"x": outcome, "reference": "ok"}
    assert run.manifest["engines"]["x"]["build"]["kind"] == "plug-in"
    command = run.results["reproduce"][0]
    assert command.endswith("--engine x:m --dt 0.02 --engines engines.toml --allow-code"), command


def test_program_gets_its_variables(folder: Path) -> None:
    """Variables from engines.toml are added to the environment of the run."""
    (folder / "engines.toml").write_text(
        f"[engines.x]\ncommand = ['{sys.executable}', '-c', 'import os; print(os.environ[\"COLOUR\"])']\n"
        "environment = { COLOUR = 'blue' }\n"
    )
    admit_file(Path("engines.toml"), allow_code=True)
    with pytest.raises(InputError, match="blue"):
        select(["mine.toml"], engines=["x"])


STEPS = """
from dataclasses import replace
import numpy as np
from bodycheck.reference_impl.rotations import quaternion_product


def _slope(state):
    force, torque = state.loads()
    inertia, omega = state.body.inertia, state.omega_body
    angular_acceleration = np.linalg.solve(inertia, torque - np.cross(omega, inertia @ omega))
    rate = 0.5 * quaternion_product(state.quaternion, np.array([0.0, *omega]))
    acceleration = force / state.body.mass
    return {
        "position": state.velocity,
        "velocity": acceleration,
        "omega_body": angular_acceleration,
        "quaternion": rate,
    }


def _moved(state, slope, dt):
    parts = {name: getattr(state, name) + dt * rate for name, rate in slope.items()}
    return replace(state, t_s=state.t_s + dt, **parts)


def rk4(state, dt):
    first = _slope(state)
    second = _slope(_moved(state, first, dt / 2))
    third = _slope(_moved(state, second, dt / 2))
    fourth = _slope(_moved(state, third, dt))
    mean = {name: (first[name] + 2 * second[name] + 2 * third[name] + fourth[name]) / 6 for name in first}
    return _moved(state, mean, dt)


again = rk4
"""


def _shortened(name: str, folder: Path) -> Path:
    """Return the file of a built-in scenario shortened to a tenth, because steps in Python are slow."""
    text = (Path(bodycheck.__file__).parent / f"scenarios/library/{name}.toml").read_text()
    path, before = folder / f"{name}.toml", tomllib.loads(text)
    after = {"duration_s": before["duration_s"] / 10.0, "samples": 11}
    for key, value in after.items():
        text = text.replace(f"\n{key} = {before[key]}\n", f"\n{key} = {value}\n")
    assert tomllib.loads(text) == {**before, **after}
    path.write_text(text)
    return path


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    "scenario",
    [
        "thruster",
        "damped-fall",
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("sine-torque", "compass")),
    ],
)
def test_step_function_of_a_module_gets_all_that_an_engine_gets(scenario: str, folder: Path) -> None:
    """RK4 under state.loads() makes the steps of the reference's rk4, for constant and continuous loads."""
    (folder / "own_steps.py").write_text(STEPS)
    file, engines = _shortened(scenario, folder), ["own_steps:rk4", "reference:rk4"]
    run = bodycheck.run([file], engines=engines, dt_s=[1e-2], speed=False, laws=False, allow_code=True)
    assert {case.columns["outcome"] for case in run.cases} == {"ok"}
    one, other = (case.trajectory for case in run.cases)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(one.attitude, other.attitude, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(one.position_m, other.position_m, rtol=1e-10, atol=1e-10)
    own = run.probes[run.probes["engine"] == "own_steps"]
    assert len(own) > 0
    assert "inconsistent" not in set(own["verdict"])
    assert "--allow-code" in run.results["reproduce"][0]


def test_code_of_a_module_runs_only_where_allowed(folder: Path, expected_message: ExpectedMessage) -> None:
    """The error names the function and the option --allow-code; a missing module is an unknown engine."""
    (folder / "own_code.py").write_text("import pathlib\npathlib.Path('ran').touch()\n")
    with expected_message.raises(InputError):
        select(["mine.toml"], engines=["own_code:step"])
    assert not (folder / "ran").exists()
    with expected_message.raises(InputError):
        select(["mine.toml"], engines=["own_code:step"], allow_code=True)
    with expected_message.raises(InputError):
        select(["mine.toml"], engines=["missing_code:step"], allow_code=True)


def test_module_needs_permission_in_each_run(folder: Path, expected_message: ExpectedMessage) -> None:
    """--allow-code in one run permits nothing in the next; within a run, another function is found too."""
    (folder / "permitted_steps.py").write_text(STEPS)
    select(["mine.toml"], engines=["permitted_steps:rk4"], allow_code=True)
    select(["mine.toml"], engines=["permitted_steps:again"], allow_code=True)
    with expected_message.raises(InputError):
        select(["mine.toml"], engines=["permitted_steps:rk4"])


def test_file_of_engines_is_read_only_if_it_is_named(folder: Path, expected_message: ExpectedMessage) -> None:
    """A short name that an engines.toml of the working directory defines is an unknown engine."""
    (folder / "engines.toml").write_text("[engines.other]\ncommand = ['true']\n")
    with expected_message.raises(InputError):
        bodycheck.run(["mine.toml"], engines=["other"], allow_code=True)


def test_only_an_admitted_program_is_a_valid_engine(folder: Path, expected_message: ExpectedMessage) -> None:
    """A command that nobody asked the gate about is refused, whatever reads its name."""
    del folder
    with expected_message.raises(InputError):
        select(["mine.toml"], engines=["cmd:true"])
    admit(["cmd:true"], allow_code=True)
    with pytest.raises(InputError, match="exited with status 0"):
        select(["mine.toml"], engines=["cmd:true"])
