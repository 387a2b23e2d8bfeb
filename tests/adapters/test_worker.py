"""The worker protocol: the page docs/workers.md, the rules for every worker, and faulty workers."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodycheck._util.errors import WorkerLostError
from bodycheck.adapters.contract import Engine, Reading, read_back_mismatch
from bodycheck.adapters.execution import Answer, record
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers import case_messages, protocol, received_messages
from bodycheck.adapters.workers.engine_pool import EnginePool, announced
from bodycheck.adapters.workers.worker_process import WorkerProcess
from bodycheck.reference_impl.scene import (
    Drag,
    GravityGradient,
    Load,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    Spring,
    State,
    Torque,
    TorsionSpring,
)
from tests.helpers.expected_messages import ExpectedMessage

PAGE = (Path(__file__).parents[2] / "docs/workers.md").read_text(encoding="utf-8")
TRANSCRIPT = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)[0].splitlines()
PROGRAM = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)[0]
REQUESTS = [line[2:] for line in TRANSCRIPT if line.startswith("> ")]
ANSWERS = [line[2:] for line in TRANSCRIPT if line.startswith("< ")]
CASE: dict[str, Any] = json.loads(REQUESTS[0])["case"]
PATIENCE_S = 600.0
"""An answer that takes longer is assumed never to arrive; the machine may be busy."""

WORKERS = {
    "of the docs": ([sys.executable, "-c", PROGRAM], "drift"),
    "reference": (
        [sys.executable, "-m", "bodycheck.adapters.workers.worker", "reference", "4000000000"],
        "m1",
    ),
    "mujoco": ([sys.executable, "-m", "bodycheck.adapters.workers.worker", "mujoco", "4000000000"], "euler"),
}


def answers_of(command: list[str], lines: list[str]) -> list[str]:
    """Return the answers of a worker to these lines; it must end with status 0 after them."""
    text = "".join(f"{line}\n" for line in lines)
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    return done.stdout.splitlines()


def test_worker_of_the_docs_gives_the_answers_of_the_docs() -> None:
    """The answers to the requests of the page equal those shown, except for times, and none is missing."""
    timed = re.compile(r'("cpu_s": )[^}]*')
    answers = answers_of(WORKERS["of the docs"][0], REQUESTS)
    assert [timed.sub(r"\1", line) for line in answers] == [timed.sub(r"\1", line) for line in ANSWERS]
    requested = {json.loads(line)["do"] for line in REQUESTS if line.startswith("{")}
    assert requested == {"record", "prepare", "lap", "stable-step"}


@pytest.mark.parametrize("line", [line for line in REQUESTS if '"case"' in line])
def test_case_of_the_docs_survives_its_message(line: str) -> None:
    """A case of the page that is read and written again gives the same message."""
    case = json.loads(line)["case"]
    assert case_messages.case_message(case_messages.case_of(case)) == case


def test_search_of_the_docs_survives_its_message() -> None:
    """The search of the page that is read and written again gives the same message; its answer is valid."""
    (line,) = (line for line in REQUESTS if "stable-step" in line)
    request = json.loads(line)
    search = case_messages.search_of(request)
    assert {"id": request["id"], "do": "stable-step", **case_messages.search_message(search)} == request
    (answer,) = (found for found in map(json.loads, ANSWERS) if found.get("id") == request["id"])
    assert received_messages.stable_step_of(answer).outcome == "unsupported"


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("worker", WORKERS)
def test_worker_conforms(worker: str) -> None:
    """A worker announces itself, answers each request by its id, survives invalid input and exits with 0."""
    if worker == "mujoco":
        pytest.importorskip("mujoco")
    command, method = WORKERS[worker]
    case = {**CASE, "method": method}
    requests = [
        {"id": 7, "do": "record", "case": case},
        {"id": 8, "do": "record", "case": {**case, "dt_s": None, "tolerance": "no case at all"}},
        {"id": 9, "do": "prepare", "case": case},
        {"id": 10, "do": "lap"},
        {"id": 11, "do": "lap"},
    ]
    lines = [json.dumps(request) for request in requests]
    found = [json.loads(line) for line in answers_of(command, [*lines[:2], "no request", "[1]", *lines[2:]])]
    announcement, recorded, refused, *nonsense, prepared, lap, again = found
    engine, accepted = received_messages.engine_of(announcement)
    assert announcement["bodycheck"] == protocol.VERSION
    assert accepted > 10_000
    assert method in engine.methods
    assert [answer["id"] for answer in found[1:]] == [7, 8, None, None, 9, 10, 11]
    requested = case_messages.case_of(case)
    answer = received_messages.answer_of(recorded, requested.scene.sample_times)
    assert answer.outcome == "ok"
    assert answer.trajectory is not None
    assert answer.read_back is not None
    assert read_back_mismatch(requested.scene, requested.setting.dt_s, answer.read_back) is None
    # a drifting body's positions are sums of powers of two, which are exact in doubles
    assert answer.trajectory.position_m.tolist() == [[0.0, 0.0, 0.0], [0.5, 0.0, -0.25], [1.0, 0.0, -0.5]]
    assert refused["outcome"] == "failed"
    assert all(answer["outcome"] == "failed" for answer in nonsense)
    assert prepared["outcome"] == "ok"
    assert received_messages.lap_of(lap) > 0.0
    assert received_messages.lap_of(again) > 0.0


def test_worker_reports_an_unavailable_engine() -> None:
    """An unknown engine is announced as unavailable; a wrong command line prints the usage."""
    command = [sys.executable, "-m", "bodycheck.adapters.workers.worker"]
    (line,) = answers_of([*command, "havok", "4000000000"], [])
    assert json.loads(line)["unavailable"].startswith("unknown engine 'havok' (available: mujoco, ")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr == "usage: python -m bodycheck.adapters.workers.worker ENGINE MEMORY_BYTES\n"


# ------------------------------------------------------------------- trials of workers in other languages

TRIALS = Path(__file__).parents[2] / "tools/worker_trials.py"
DRIFTING = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)[1]
BROKEN = {
    "a state too few": ("return states", "return states[1:]", "failed .* a trajectory of 10 states, not 11"),
    "another mass": (
        '**scene["body"]',
        '**scene["body"], "mass": 4.0',
        "invalid .* mass is 4. in the engine",
    ),
    "nothing measured": ('if scene["loads"]', 'if True or scene["loads"]', "a case ends well: nothing was"),
    "another id": ('"id": request_id, **answer', '"id": 7, **answer', "failed .* it answered 7, not 1"),
    "no id": (
        '"id": request_id, "outcome": "failed"',
        '"outcome": "failed"',
        "NOT KEPT: .* under the id null: ",
    ),
    "no time": ("time.process_time() - begin", "0.0", "NOT KEPT: a lap of it is timed: it took no time"),
    "no search, but a lap": (
        'request["do"] == "lap"',
        "True",
        "NOT KEPT: a search .* invalid search result: stable_s: Field required",
    ),
    "anything done": (
        "raise ValueError(",
        'return {"outcome": "ok"}  # (',
        "NOT KEPT: a request that is none has failed: ",
    ),
    "another end": (
        "import json,",
        "import atexit, os; atexit.register(os._exit, 3)\nimport json,",
        "NOT KEPT: .* its input ends: status 3",
    ),
}
"""The change in the worker of the docs, and the fault that is then reported."""


def tried(program: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> object:
    """Run tools/worker_trials.py on a worker with the scenario of the docs, and return its result."""
    (folder / "worker.py").write_text(program)
    (folder / "drifting.toml").write_text(DRIFTING)
    words = ["--scenarios", str(folder / "drifting.toml"), sys.executable, str(folder / "worker.py")]
    monkeypatch.setattr("sys.argv", [str(TRIALS), *words])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(TRIALS), run_name="__main__")
    return end.value.code


def test_worker_of_the_docs_passes_its_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The worker of the docs follows all rules, and a drifting body's attitude is exact."""
    assert tried(PROGRAM, tmp_path, monkeypatch) == 0
    printed = capsys.readouterr().out
    assert printed.count("ok          0.0e+00 rad") == 2
    assert printed.count("kept: ") == 9


@pytest.mark.parametrize("what", BROKEN)
def test_trial_reports_each_fault_of_a_worker(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One fault in the worker of the docs gives status 1 and a line that names the fault."""
    right, wrong, found = BROKEN[what]
    assert PROGRAM.count(right) == 1
    assert tried(PROGRAM.replace(right, wrong), tmp_path, monkeypatch) == 1
    assert re.search(found, capsys.readouterr().out)


# ------------------------------------------------------------------------------------------- messages

LOADS: tuple[Load, ...] = (
    Torque("body", np.array([0.1, 0.2, 0.3]), 0.5, 0.75),
    PointForce("world", np.array([1e-300, -0.0, 1e300]), np.array([0.1, 0.0, 0.0])),
    SineTorque("world", np.array([0.0, 1.0, 0.0]), 2.0, 0.1),
    Drag(0.1, np.diag([1.0, 2.0, 3.0])),
    Spring(np.array([0.0, 0.0, 1.0]), np.array([0.1, 0.0, 0.0]), 3.0, 0.5),
    TorsionSpring(0.7),
    GravityGradient(1e-3),
)
STATE = State(
    np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 0.2, 0.3])
)


@pytest.mark.parametrize("load", LOADS, ids=lambda load: type(load).__name__)
def test_scene_survives_its_message(load: Load) -> None:
    """Under any load a worker reads exactly the scene that was sent."""
    body = RigidBody(1.0 / 3.0, np.diag([0.1, 0.2, 0.1 + 0.2]))
    scene = Scene(body, STATE, (load,), np.array([0.0, 0.0, -9.81]), 0.1, 4)
    back = case_messages.scene_of(json.loads(json.dumps(case_messages.scene_message(scene), allow_nan=False)))
    for sent, received in [(scene.body, back.body), (scene.initial, back.initial), (load, back.loads[0])]:
        assert type(sent) is type(received)
        for name, value in vars(sent).items():
            assert np.asarray(value).tobytes() == np.asarray(getattr(received, name)).tobytes(), name
    assert (back.duration_s, back.samples, back.gravity.tolist()) == (0.1, 4, [0.0, 0.0, -9.81])


@pytest.mark.parametrize("load", LOADS, ids=lambda load: type(load).__name__)
def test_docs_list_the_keys_of_every_load(load: Load) -> None:
    """The table of the page lists exactly the keys of each load, next to its kind."""
    body = RigidBody(1.0, np.eye(3))
    scene = Scene(body, STATE, (load,), np.zeros(3), 0.1, 4)
    (load,) = case_messages.scene_message(scene)["loads"]
    (keys,) = re.findall(rf"^\| `{load.pop('kind')}` \| (.*) \|$", PAGE, flags=re.MULTILINE)
    assert set(re.findall(r"`(\w+)`", keys)) - {"body", "world"} == set(load)


@pytest.mark.parametrize("shape", [(0,), (5,), (2, 3), (2, 3, 3)])
def test_array_survives_its_message(shape: tuple[int, ...]) -> None:
    """Infinities, NaN, negative zero and subnormal numbers arrive bit for bit."""
    values = np.resize(np.array([0.1, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1.7976931348623157e308]), shape)
    message = json.loads(json.dumps(protocol.packed(values)))
    assert protocol.unpacked(message).tobytes() == values.tobytes()
    assert protocol.unpacked(message).shape == shape


NO_ARRAYS: list[Any] = [
    {},
    [],
    None,
    {"shape": [3], "base64": "AAAA"},
    {"shape": [1], "base64": "?AAAAAAAAAA="},
    {"shape": [2], "base64": "AAAAAAAAAAA="},
    {"shape": "x", "base64": "AAAAAAAAAAA="},
    {"shape": [1], "base64": 7},
]


@pytest.mark.parametrize("value", NO_ARRAYS, ids=str)
def test_invalid_array_is_refused(value: Any, expected_message: ExpectedMessage) -> None:
    """A wrong shape, a truncated text and a value that is not text are refused."""
    with expected_message.raises(protocol.ProtocolError):
        protocol.unpacked(value)


@pytest.mark.parametrize(
    "values", [["1.0"], [None], [1j], [True], [b"1"]], ids=["text", "object", "complex", "bool", "bytes"]
)
def test_only_real_numbers_are_packed(values: list[Any], expected_message: ExpectedMessage) -> None:
    """A text that looks like a number is refused."""
    with expected_message.raises(protocol.ProtocolError):
        protocol.packed(np.array(values))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), {1}, np.int64(1), b"x"], ids=str)
def test_line_contains_only_json(value: Any, expected_message: ExpectedMessage) -> None:
    """Values that are not valid JSON are refused."""
    with expected_message.raises(protocol.ProtocolError):
        protocol.line_of({"value": value})


def test_line_has_a_maximum_length(
    monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """A line that is one byte longer than the maximum is refused."""
    length = len(protocol.line_of({"text": "x" * 100}))
    monkeypatch.setattr(protocol, "LARGEST_MESSAGE", length)
    assert len(protocol.line_of({"text": "x" * 100})) == length
    with expected_message.raises(protocol.ProtocolError):
        protocol.line_of({"text": "x" * 101})


def test_nan_mass_is_read_back_as_nan() -> None:
    """The comparison reports the NaN instead of losing the answer."""
    case = case_messages.case_of({**CASE, "method": "m1"})
    answer = record(Reference(), case)
    assert answer.read_back is not None
    held = answer.read_back.__class__(**{**vars(answer.read_back), "mass": np.nan, "dt_s": np.inf})
    message = protocol.answer_message(Answer("ok", "", answer.trajectory, held, "native"))
    back = received_messages.answer_of(json.loads(protocol.line_of(message)), case.scene.sample_times)
    assert back.read_back is not None
    fault = read_back_mismatch(case.scene, case.setting.dt_s, back.read_back)
    assert fault == "mass is nan in the engine, not 2.; step is nan in the engine, not 0.25"


def listed(**changes: Any) -> dict[str, Any]:
    """Return the answer of the docs, whose numbers are lists, with other values."""
    answer = json.loads(ANSWERS[1])
    return {**answer, **changes}


def test_listed_numbers_are_those_of_the_arrays() -> None:
    """A trajectory as a list of states, and one as arrays over time, in base64 or as lists, are the same."""
    scene = case_messages.case_of(CASE).scene
    states = received_messages.answer_of(listed(), scene.sample_times)
    assert states.trajectory is not None
    assert (states.stepping, states.steps) == ("native", None)
    packed = protocol.answer_message(states)
    in_base64 = received_messages.answer_of(packed, scene.sample_times)
    columns = {name: protocol.unpacked(value).tolist() for name, value in packed["trajectory"].items()}
    as_lists = received_messages.answer_of(listed(trajectory=columns), scene.sample_times)
    for answer in (in_base64, as_lists):
        assert answer.trajectory is not None
        for name, values in vars(states.trajectory).items():
            np.testing.assert_array_equal(values, getattr(answer.trajectory, name))


def test_null_in_a_list_is_a_number_that_is_not_finite() -> None:
    """The state of an unstable motion can be written in JSON."""
    states = listed()["trajectory"]
    states[-1]["velocity"] = [None, 0.0, 0.0]
    found = received_messages.answer_of(
        listed(trajectory=states), case_messages.case_of(CASE).scene.sample_times
    )
    assert found.trajectory is not None
    assert np.isnan(found.trajectory.velocity_m_s[-1]).tolist() == [True, False, False]


LISTED = {"position": [0, 0, 0], "velocity": [0, 0, 0], "quaternion": [1, 0, 0, 0], "omega_body": [0, 0, 0]}
WRONG_LISTS: dict[str, Any] = {
    "too few states": [LISTED, LISTED],
    "a number too many": [LISTED, LISTED, {**LISTED, "position": [0, 0, 0, 0]}],
    "rows of different lengths": [LISTED, LISTED, {**LISTED, "rotation": [[1, 0, 0], [0, 1], [0, 0, 1]]}],
    "digits in a string": [LISTED, LISTED, {**LISTED, "velocity": ["1", 0, 0]}],
    "a truth value": [LISTED, LISTED, {**LISTED, "velocity": [True, 0, 0]}],
    "states without velocity": 3 * [{name: LISTED[name] for name in LISTED if name != "velocity"}],
    "a quantity that is there once": [LISTED, LISTED, {**LISTED, "omega_world": [0, 0, 0]}],
    "a quantity that is missing once": [{**LISTED, "omega_world": [0, 0, 0]}, LISTED, LISTED],
    "an unknown quantity": 3 * [{**LISTED, "colour": [0, 0, 0]}],
    "no list of states": 7,
    "times of another rounding": {
        "t_s": [0.0, 0.5, 1.0000000000000002],
        "quaternion": 3 * [[1, 0, 0, 0]],
        **dict.fromkeys(("position_m", "velocity_m_s", "omega_body_rad_s"), 3 * [[0, 0, 0]]),
    },
}


@pytest.mark.parametrize("what", WRONG_LISTS)
def test_wrong_list_of_states_is_refused(what: str, expected_message: ExpectedMessage) -> None:
    """The message says what is wrong with the answer."""
    t_s = case_messages.case_of(CASE).scene.sample_times
    with expected_message.raises(protocol.ProtocolError):
        received_messages.answer_of(listed(trajectory=WRONG_LISTS[what]), t_s)


@pytest.mark.parametrize("shape", [(), (3,), (5,), (2, 4), (0,)], ids=str)
@pytest.mark.parametrize("part", ["position", "velocity", "quaternion", "omega_body", "inertia", "gravity"])
def test_wrong_shape_of_read_back_is_a_mismatch(part: str, shape: tuple[int, ...]) -> None:
    """The case is invalid with a message about the value, and the run continues."""
    case = case_messages.case_of({**CASE, "method": "m1"})
    held = record(Reference(), case).read_back
    assert held is not None
    if shape == (3,) and part not in ("quaternion", "inertia"):
        shape = (4,)
    wrong = np.ones(shape)
    if part in vars(held):
        held = replace(held, **{part: wrong})
    else:
        held = replace(held, state=replace(held.state, **{part: wrong}))
    fault = read_back_mismatch(case.scene, case.setting.dt_s, held)
    assert fault is not None
    assert fault.startswith(f"{part} is ")


@pytest.mark.parametrize(
    ("kept", "missing"), [("omega_body", "neither a quaternion nor a rotation"), ("quaternion", "no omega")]
)
def test_incomplete_read_back_is_a_mismatch(kept: str, missing: str) -> None:
    """A part of the initial state that is missing was not compared, so the case is invalid."""
    case = case_messages.case_of({**CASE, "method": "m1"})
    held = record(Reference(), case).read_back
    assert held is not None
    whole = vars(held.state)
    part = Reading(**{name: whole[name] for name in ("position", "velocity", kept)})
    fault = read_back_mismatch(case.scene, case.setting.dt_s, replace(held, state=part))
    assert fault == f"the engine returns {missing}"


# -------------------------------------------------------------------------------------- faulty workers

PYTHON = sys.executable
ANNOUNCEMENT: dict[str, Any] = json.loads(ANSWERS[0])


def announcing(**changes: Any) -> str:
    """Return a program that announces the engine of the docs with these changes, and then waits."""
    line = json.dumps({**ANNOUNCEMENT, **changes})
    return f"print({line!r}, flush=True)\nimport time; time.sleep(1000)"


METHOD = ANNOUNCEMENT["methods"][0]
WRONG_ANNOUNCEMENTS = {
    "a build that is no text": announcing(build=3),
    "a kind that is none": announcing(kind="rare"),
    "parts that are none": announcing(loaded="x"),
    "another protocol": announcing(bodycheck=2),
    "no JSON": "print('hello')",
    "no object": "print('[1, 2]')",
    "no methods": announcing(methods=None),
    "a method of another age": announcing(methods=[{"name": "x"}]),
    "a control that is none": announcing(methods=[{**METHOD, "control": "will"}]),
    "a version that is no text": announcing(version=3),
    "no limits": announcing(limits=None),
    "evaluations that are a text": announcing(methods=[{**METHOD, "evaluations": "x"}]),
    "evaluations without end": announcing(methods=[{**METHOD, "evaluations": 10**400}]),
    "a name that is half a letter": announcing(methods=[{**METHOD, "name": chr(0xD800)}]),
    "a name for the terminal": announcing(version="\x1b[31m"),
    "no method at all": announcing(methods=[]),
    "a method twice": announcing(methods=[METHOD, METHOD]),
    "a tolerance of 2": announcing(methods=[{**METHOD, "tolerances": [2.0]}]),
    "another name": announcing(engine="other"),
    "nothing at all": "",
    "a crash": "import os; os.abort()",
    "a reason": 'print(\'{"bodycheck": 1, "unavailable": "no licence"}\')',
}


def employ(program: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Start this program in place of every worker."""
    place = folder / "worker"
    place.write_text(f"#!{PYTHON}\n{program}")
    place.chmod(0o755)
    monkeypatch.setattr("bodycheck.adapters.workers.worker_process.sys.executable", str(place))


@pytest.mark.parametrize("what", WRONG_ANNOUNCEMENTS)
def test_wrong_announcement_makes_the_engine_unavailable(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """The reason describes what the worker did."""
    employ(WRONG_ANNOUNCEMENTS[what], tmp_path, monkeypatch)
    found = announced(["drift"])["drift"]
    assert isinstance(found, str)
    expected_message(found)


def answering(code: str) -> str:
    """Return a program that makes the announcement of the docs and answers each line with this code."""
    begin = f"import json, os, sys, time\nprint({json.dumps(ANNOUNCEMENT)!r}, flush=True)\n"
    return (
        f"{begin}for line in sys.stdin:\n    i = json.loads(line)['id']\n    {code}\n    sys.stdout.flush()\n"
    )


WRONG_ANSWERS = {
    "no JSON": ("print('hm')", "failed"),
    "JSON without end": ("print('[' * 3000)", "failed"),
    "another id": ("print(json.dumps({'id': i + 1}))", "failed"),
    "two answers": ("print(json.dumps({'id': i}) * 2)", "failed"),
    "no end": ("sys.stdout.write('x' * 5000)", "failed"),
    "no answer": ("time.sleep(1000)", "timeout"),
    "half an answer": ("sys.stdout.write('{'); sys.stdout.flush(); os._exit(3)", "failed"),
    "closed": ("os.close(1); os.close(2); os._exit(4)", "failed"),
    "last words": ("sys.stderr.write('so be it'); os._exit(4)", "failed"),
}


@pytest.mark.parametrize("what", WRONG_ANSWERS)
def test_wrong_answer_fails_its_case(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """The message describes what the worker did, and the worker is ended."""
    code, outcome = WRONG_ANSWERS[what]
    employ(answering(code), tmp_path, monkeypatch)
    monkeypatch.setattr(protocol, "LARGEST_MESSAGE", 4000)
    engine_pool = EnginePool()
    try:
        answer = engine_pool.ask(
            "drift", {"do": "record", "case": CASE}, 0.5 if outcome == "timeout" else PATIENCE_S
        )
        assert answer["outcome"] == outcome
        expected_message(answer["message"])
        assert "drift" not in engine_pool
    finally:
        engine_pool.close()


def test_worker_that_closes_its_output_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run does not wait for the time limit."""
    employ(answering("os.close(1); time.sleep(1000)"), tmp_path, monkeypatch)
    monkeypatch.setattr("bodycheck.adapters.workers.worker_process._EXIT_WAIT_S", 0.1)
    engine_pool = EnginePool()
    try:
        answer = engine_pool.ask("drift", {"do": "lap"}, PATIENCE_S)
    finally:
        engine_pool.close()
    assert answer == {"outcome": "failed", "message": "the worker closed its output and kept running"}


def test_request_above_the_announced_limit_is_not_sent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A request above the limit that the worker announced is not sent, and the message states both sizes."""
    employ(announcing(limits={"message_bytes": 100}), tmp_path, monkeypatch)
    host = WorkerProcess("drift")
    try:
        answer = host.ask({"do": "record", "case": CASE}, PATIENCE_S)
    finally:
        host.close()
    assert answer["outcome"] == "failed"
    assert re.fullmatch(r"a request of \d+ bytes \(limit: 100\)", answer["message"])


def test_failure_to_start_a_process_fails_the_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The case fails with the reason, and the run continues."""
    monkeypatch.setattr("bodycheck.adapters.workers.worker_process.sys.executable", str(tmp_path / "none"))
    engine_pool = EnginePool()
    try:
        answer = engine_pool.ask("drift", {"do": "record", "case": CASE}, PATIENCE_S)
    finally:
        engine_pool.close()
    assert answer == {"outcome": "failed", "message": "no worker can be started: No such file or directory"}


def test_closed_worker_is_not_killed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A closed worker is not killed, because its process id may belong to another process."""
    employ(announcing(), tmp_path, monkeypatch)
    host = WorkerProcess("drift")
    killed: list[int] = []
    killpg = os.killpg
    monkeypatch.setattr(os, "killpg", lambda group, how: (killed.append(group), killpg(group, how)))
    host.close()
    host.kill()
    host.close()
    assert killed == [host.pid]


FORGETFUL = "print(json.dumps({'id': i, 'outcome': 'failed' if i > 1 else 'ok', 'message': 'I forgot'}))"


def test_failure_in_a_used_worker_is_repeated_in_a_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer of the new worker counts, and its message states that the case ran twice."""
    employ(answering(FORGETFUL), tmp_path, monkeypatch)
    engine_pool, request = EnginePool(), {"do": "record", "case": CASE}
    try:
        assert engine_pool.ask("drift", request, 5.0)["message"] == "I forgot"
        again = engine_pool.ask("drift", request, 5.0)
    finally:
        engine_pool.close()
    assert again["outcome"] == "ok"
    assert again["message"] == "ran twice; failed in a worker that had run other cases: I forgot"


def killed_once(folder: Path) -> str:
    """Return code that kills the first process that runs it."""
    mark = str(folder / "killed")
    return f"os.path.exists({mark!r}) or (open({mark!r}, 'w'), os.kill(os.getpid(), 9))"


def test_engine_whose_worker_is_killed_while_it_starts_is_started_once_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker killed from outside before its announcement does not remove its engine from the run."""
    employ(f"import os\n{killed_once(tmp_path)}\n{answering('pass')}", tmp_path, monkeypatch)
    assert isinstance(announced(["drift"])["drift"], Engine)


def test_case_of_a_killed_worker_is_repeated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker killed from outside runs its case once more; if it is killed again, the case has failed."""
    say = "print(json.dumps({'id': i, 'outcome': 'ok'}))"
    employ(answering(f"{killed_once(tmp_path)}; {say}"), tmp_path, monkeypatch)
    engine_pool = EnginePool()
    assert engine_pool.ask("drift", {"do": "record"}, 5.0) == {"id": 1, "outcome": "ok", "build": ""}
    engine_pool.close()
    employ(answering("os.kill(os.getpid(), 9)"), tmp_path, monkeypatch)
    engine_pool = EnginePool()
    answer = engine_pool.ask("drift", {"do": "record"}, 5.0)
    engine_pool.close()
    assert answer == {"outcome": "failed", "message": "the worker was killed by SIGKILL"}


def test_stopped_engine_pool_starts_no_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """No worker is started after a run was stopped."""
    employ(answering(FORGETFUL), tmp_path, monkeypatch)
    engine_pool = EnginePool()
    engine_pool.stop()
    with expected_message.raises(WorkerLostError):
        engine_pool.ask("drift", {"do": "record", "case": CASE}, 5.0)
