"""Faults of engines: each fails the case in which it occurs, and no other case."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from html import unescape
from pathlib import Path

import pandas as pd
import pytest

import bodycheck
from bodycheck.adapters import registry
from bodycheck.adapters.registry import register_adapter, registered
from bodycheck.adapters.step_function import StepFunction, StepState
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import NULL_PROGRESS
from bodycheck.runs.runner import run_selection
from bodycheck.runs.selection import select
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.misbehaving_engine import (
    ACTS,
    BAD_STEP_S,
    LIES,
    ONLY_TIMED,
    READINGS,
    SOLUTIONS,
    VALID_STEPS_S,
    Misbehaving,
)
from tests.helpers.scenario_texts import RUN_SPECIFIC_COLUMNS, SCENARIO
from tests.helpers.worker_processes import all_gone

TIMEOUT_S = 4.0

ENDINGS = {
    "abort": ("failed", "the worker was killed by SIGABRT"),
    "segfault": ("failed", "the worker was killed by SIGSEGV"),
    "exit": ("failed", "the worker exited with status 7"),
    "exit-0": ("failed", "the worker exited with status 0"),
    "loop": ("timeout", "no answer within 4 s"),
    "c-loop": ("timeout", "no answer within 4 s"),
    "sleep": ("timeout", "no answer within 4 s"),
    "swell": ("failed", "MemoryError: Unable to allocate"),
    "swell-beyond": ("failed", "MemoryError: Unable to allocate 8.00 TiB"),
    "print-flood": ("ok", ""),
    "raw-flood": ("ok", ""),
    "speak-and-abort": (
        "failed",
        "the worker was killed by SIGABRT; its last output: the solver met a singular matrix",
    ),
    "raise": ("failed", "RuntimeError: the solver gave up"),
    "system-exit": ("failed", "SystemExit: 3"),
    "keyboard-interrupt": ("failed", "KeyboardInterrupt:"),
    "generator-exit": ("failed", "GeneratorExit:"),
    "unprintable": ("failed", "UnprintableError"),
    "endless-words": ("failed", "RuntimeError: ??zzz"),
    "recurse": ("failed", "RecursionError: maximum recursion depth exceeded"),
    "close-output": ("ok", ""),
    "close-all": ("failed", "the worker exited with status 1"),
    "leave-a-fork": ("failed", "the worker exited with status 5"),
    "leave-a-child": ("failed", "the worker exited with status 5"),
    "spoil": ("ok", ""),
    "infinite": ("unstable", "omega_body_rad_s is not finite from t = 0.1 s on"),
    "nan": ("unstable", "position_m is not finite from t = 0 s on"),
    "shape": ("failed", "position_m has the shape (11, 4), not (11, 3)"),
    "ragged": ("failed", "ValueError"),
    "text": ("failed", "an array of <U3, not of real numbers"),
    "object": ("failed", "an array of object, not of real numbers"),
    "nothing": ("failed", "TypeError: a reading without position or velocity"),
    "other-mass": ("invalid", "mass is 1.5 in the engine, not 1."),
    "few": ("failed", "a trajectory that is not at the scene's samples"),
    "none": ("failed", "invalid answer: trajectory: Field required"),
    ONLY_TIMED: ("ok", ""),
}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of a small scenario."""
    path = tmp_path_factory.mktemp("faults") / "mine.toml"
    path.write_text(SCENARIO)
    return path


def run_of(scenario: Path, *, sound: bool, methods: list[str], speed: bool) -> Run:
    """Return a run, without laws, of the misbehaving engine or its correct twin, and of the reference's m1.

    Other tests cover the laws of engines that fail; here they would take most of the time. Nothing is reused,
    so that rows do not depend on the order of the tests.
    """
    with registered(Misbehaving(sound=sound)):
        engines = [*(f"misbehaving:{method}" for method in methods), "reference:m1"]
        selection = select([scenario], engines, [*VALID_STEPS_S, BAD_STEP_S])
        options = Request(speed=speed, timeout_s=TIMEOUT_S, fresh=True, laws=False)
        return run_selection(selection, options, Identity.new(), journal=None, progress=NULL_PROGRESS)


def rows_of(run: Run) -> pd.DataFrame:
    """Return the rows without the columns that differ between equal runs."""
    return run.results.drop(columns=RUN_SPECIFIC_COLUMNS)


def goes_wrong(rows: pd.DataFrame) -> pd.Series[bool]:
    """Return which rows are cases in which the engine misbehaves."""
    solved = rows["method"].isin(list(SOLUTIONS))
    return (rows["engine"] == "misbehaving") & (solved | (rows["dt_s"] == BAD_STEP_S))


@pytest.fixture(scope="module")
def sound(scenario: Path) -> Run:
    """Return the run in which the engine behaves correctly."""
    return run_of(scenario, sound=True, methods=list(ENDINGS), speed=False)


@pytest.fixture(scope="module")
def faulty(scenario: Path) -> Iterator[Run]:
    """Return the run in which each method of the engine misbehaves at one step."""
    yield run_of(scenario, sound=False, methods=list(ENDINGS), speed=False)
    assert all_gone(os.getpid())


def test_every_kind_of_fault_has_an_expected_outcome() -> None:
    """Each kind of misbehaviour has an expected outcome."""
    assert set(ENDINGS) == {*ACTS, *READINGS, *LIES, *SOLUTIONS, ONLY_TIMED}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ENDINGS)
def test_fault_is_the_outcome_of_its_case(kind: str, faulty: Run) -> None:
    """The row has the outcome and the reason, in one line of limited length."""
    rows = faulty.results[goes_wrong(faulty.results) & (faulty.results["method"] == kind)]
    row = rows.iloc[0]
    outcome, message = ENDINGS[kind]
    assert len(rows) == 1
    assert (row["outcome"], message in row["message"]) == (outcome, True), row["message"]
    if kind in ("raise", "system-exit", "other-mass", "infinite"):
        assert row["message"] == message
    assert len(row["message"]) < 2000
    assert row["message"].isprintable()
    assert row[["orientation_error_rad", "energy_drift"]].isna().all() == (outcome != "ok")


@pytest.mark.slow
def test_report_has_every_message(faulty: Run, tmp_path: Path) -> None:
    """The report contains each message."""
    report = unescape(bodycheck.write_run(faulty, tmp_path / "out").read_text())
    for _, message in ENDINGS.values():
        assert message in report


@pytest.mark.nightly
def test_fault_changes_no_other_case(faulty: Run, sound: Run) -> None:
    """All other rows equal those of a run without a fault bit for bit, also after a flood of output."""
    rows, expected = rows_of(faulty), rows_of(sound)
    others = ~goes_wrong(rows)
    # a repeated request detects and reports state that an earlier case left in its worker
    reported = "ran twice; failed in a worker that had run other cases: RuntimeError: spoilt"
    spoilt = rows["message"].str.startswith(reported)
    rows.loc[spoilt, "message"] = ""
    pd.testing.assert_frame_equal(rows[others], expected[others], check_exact=True)
    chatty = rows["method"].isin(["print-flood", "raw-flood", "close-output", "spoil"])
    pd.testing.assert_frame_equal(rows[chatty], expected[chatty], check_exact=True)
    assert (expected["outcome"] == "ok").all()
    errors = rows.loc[rows["engine"] == "reference", "orientation_error_rad"]
    assert ((errors > 0.0) & (errors < 0.1)).all()


@pytest.mark.nightly
def test_engine_that_dies_while_timed_loses_only_its_speed(scenario: Path) -> None:
    """The row keeps its measures and states the reason; all other successful cases have a speed."""
    methods = ["close-output", "other-mass", ONLY_TIMED]
    faulty = run_of(scenario, sound=False, methods=methods, speed=True)
    rows, expected = rows_of(faulty), rows_of(run_of(scenario, sound=True, methods=methods, speed=False))
    well = rows["outcome"] == "ok"
    assert well.sum() == len(rows) - 1
    died = goes_wrong(rows) & (rows["method"] == ONLY_TIMED)
    assert rows["message"][died].tolist() == ["speed not measured: the worker was killed by SIGABRT"]
    for speed in ("cpu_s", "relative_cpu"):
        assert faulty.results[speed].isna().tolist() == (died | ~well).tolist()
    rows, expected = rows[well].drop(columns="message"), expected[well].drop(columns="message")
    pd.testing.assert_frame_equal(rows, expected, check_exact=True)


AT_IMPORT = {
    "abort": ("import os\nos.abort()", "ghost cannot be started: the worker was killed by SIGABRT"),
    "segfault": (
        "import ctypes\nctypes.string_at(0)",
        "ghost cannot be started: the worker was killed by SIGSEGV",
    ),
    "exit": ("import os\nos._exit(3)", "ghost cannot be started: the worker exited with status 3"),
    "system-exit": ("raise SystemExit(4)", "ghost cannot be started: the worker exited with status 4"),
    "raise": ("raise RuntimeError('no licence')", "ghost cannot be imported: RuntimeError: no licence"),
    "missing": ("import no_such_engine", "ghost cannot be imported: No module named 'no_such_engine'"),
    "no-adapter": ("Ghost = object", "ghost is not an adapter: it has no name, no version, no methods"),
    "hang": ("while True: pass", "ghost cannot be started: no answer within 3 s"),
    "chatter": (
        "import os\nprint('licence expired')\nos._exit(3)",
        "the worker exited with status 3; its last output: licence expired",
    ),
    "other-name": (
        "from tests.helpers.misbehaving_engine import Misbehaving as Ghost",
        "ghost announces itself as 'misbehaving'",
    ),
}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("kind", AT_IMPORT)
def test_engine_that_cannot_be_imported_is_refused_in_one_line(
    kind: str, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However the import fails, a run of this engine ends with the reason; one of others warns with it."""
    code, reason = AT_IMPORT[kind]
    (tmp_path / "ghost.py").write_text(code)
    facts = tmp_path / "ghost-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: ghost\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[bodycheck.adapters]\nghost = ghost:Ghost\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("bodycheck.adapters.workers.worker_process._START_S", 3.0 if kind == "hang" else 60.0)
    registry._plugged_in.cache_clear()
    try:
        with pytest.raises(bodycheck.InputError) as refused:
            bodycheck.run([scenario], engines=["ghost"], dt_s=[0.1], speed=False, laws=False)
        if kind != "hang":  # even a correct engine could miss the short deadline on a busy machine
            with pytest.warns(UserWarning, match=re.escape(reason)):
                run = bodycheck.run(
                    [scenario], engines=["ghost", "reference:m1"], dt_s=[0.1], speed=False, laws=False
                )
            assert [case.columns["outcome"] for case in run.cases] == ["ok"]
    finally:
        registry._plugged_in.cache_clear()
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)
    assert all_gone(os.getpid())


@pytest.mark.slow
def test_adapter_that_cannot_be_pickled_runs_in_the_process(scenario: Path) -> None:
    """A class local to a function is measured too, and its exception is an outcome."""

    class Local(Misbehaving):
        """An adapter that no other process can import."""

    with registered(Local()):
        engines = ["misbehaving:generator-exit", "misbehaving:nan"]
        rows = bodycheck.run(
            [scenario], engines=engines, dt_s=[0.02, BAD_STEP_S], speed=False, laws=False
        ).results
    assert rows["outcome"].tolist() == ["ok", "failed", "ok", "unstable"]
    assert rows["message"].tolist()[1] == "GeneratorExit:"


@pytest.mark.slow
def test_functions_of_this_process_make_one_motion_at_a_time() -> None:
    """A step that keeps its slopes in one array of its module is measured like one with arrays of its own."""
    inside = [0]
    at_once: set[int] = set()

    def step(state: StepState, dt: float) -> StepState:
        del dt
        inside[0] += 1
        time.sleep(1e-4)  # lets another thread run
        at_once.add(inside[0])
        inside[0] -= 1
        return state

    with registered(StepFunction(step)):
        bodycheck.run(["free-flight"], engines=["step"], dt_s=[0.2, 0.1], jobs=2, speed=False)
    assert at_once == {1}


def test_invalid_adapter_is_not_registered(expected_message: ExpectedMessage) -> None:
    """The message lists what is missing."""
    with expected_message.raises(bodycheck.InputError):
        register_adapter(object())  # type: ignore[arg-type]


SCRIPT = """
import bodycheck
from tests.helpers.misbehaving_engine import Misbehaving


class Mine(Misbehaving):
    pass


bodycheck.register_adapter(Mine())
run = bodycheck.run(["mine.toml"], engines=["misbehaving:abort"], dt_s=[0.02, 0.01], speed=False, laws=False)
print(run.results["outcome"].tolist(), run.results["message"].tolist())
"""


@pytest.mark.nightly
def test_script_that_defines_an_engine_is_isolated_from_it(tmp_path: Path) -> None:
    """A worker imports the definitions of the script but does not start a second run."""
    (tmp_path / "mine.toml").write_text(SCENARIO)
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "['ok', 'failed'] ['', 'the worker was killed by SIGABRT']\n", done.stderr
