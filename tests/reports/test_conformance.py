"""check-adapter: no healthy adapter fails, and each mistake of an adapter is described in words."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

import bodycheck
from bodycheck.adapters.contract import Adapter, Engine
from bodycheck.adapters.example import Example, ExampleSimulation
from bodycheck.adapters.execution import Answer, Case, record
from bodycheck.adapters.registry import distribution_of, registered
from bodycheck.examine.probes.adapter_checks import CHECKS, Check, CheckBench
from bodycheck.examine.probes.finding import Finding
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.document import Sentence, Table
from bodycheck.runs.engine_checks import CheckResult, Conformance, check_adapter, conformance_document
from tests.helpers.faulty_adapters import FAULTS, AdapterFault, FaultyExample
from tests.helpers.in_process_cli import run_bodycheck

TIMEOUT_S = 60.0


def findings(
    adapter: Adapter, method: str, checks: Sequence[Check] = CHECKS
) -> Iterator[tuple[Check, Finding]]:
    """Yield the findings of checks of one method, in this process."""
    engine = Engine(adapter.name, adapter.version, adapter.methods)

    def recorded(_: Engine, case: Case) -> Answer:
        return record(adapter, case)

    def replayed(_: Engine, case: Case) -> Answer:
        return record(adapter, case, again=True)

    bench = CheckBench(engine, adapter.methods[method], recorded, replayed)
    return ((check, finding) for check in checks for finding in check.findings(bench))


def failures(adapter: Adapter, method: str) -> list[tuple[str, str]]:
    """Return (check, message) of each failure."""
    found = findings(adapter, method)
    return [(check.name, finding.message) for check, finding in found if finding.verdict == "inconsistent"]


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.nightly] * (k % 2)) for k, name in enumerate(FAULTS)]
)
def test_mistake_of_an_adapter_is_described(name: str) -> None:
    """The check that concerns the mistake fails first, or after the read-back, in the right words."""
    fault = FAULTS[name]
    found = failures(FaultyExample(fault), "euler")
    assert any(check == fault.check and fault.words in message for check, message in found), found
    assert next((check for check, _ in found if check != "model"), "model") == fault.check, found


def result(check: str, verdict: str, message: str = "", after: tuple[str, ...] = ()) -> CheckResult:
    """Return a result of the method euler."""
    return CheckResult("euler", check, f"{check} holds", "size", verdict, message, after)


def test_what_may_follow_from_a_failure_is_folded_below_it() -> None:
    """Of three failures the first has its words; the second may follow from it, and the third may not."""
    found = Conformance(
        "mine",
        "1",
        (
            result("model", "consistent"),
            result("free motion", "inconsistent", "momentum changes by 3e-06 of its size"),
            result("loads", "inconsistent", "the torque acts wrongly", ("model", "free motion")),
            result("reset", "inconsistent", "reset keeps a time"),
        ),
    )
    conclusion, table = conformance_document(found).parts
    assert isinstance(table, Table)
    words = {str(row[1]): str(row[3]) for row in table.rows}
    assert "3e-06" in words["free motion"]
    assert "free motion" in words["loads"]
    assert "wrongly" not in words["loads"]
    assert "keeps a time" in words["reset"]
    assert isinstance(conclusion, Sentence)
    assert "correct first: free motion" in str(conclusion.text)


def test_a_check_follows_from_earlier_ones_only() -> None:
    """The causes stand before their consequences, and exist."""
    names = [check.name for check in CHECKS]
    for place, check in enumerate(CHECKS):
        assert set(check.after) <= set(names[:place]), check.name


@pytest.mark.slow
def test_a_small_damping_is_one_failure_with_its_size() -> None:
    """A loss of 3e-7 of omega per second shows as a change, not as a factor of 1, and is named first."""

    class Leaking(ExampleSimulation):
        def advance(self, steps: int) -> None:
            for _ in range(steps):
                super().advance(1)
                self.omega = self.omega * (1.0 - 3e-7 * self.dt_s)

    found = failures(FaultyExample(AdapterFault(Leaking, "free motion", "momentum changes by")), "euler")
    check, message = found[0]
    assert check == "free motion"
    assert "momentum changes by" in message
    assert "1 times" not in message


@pytest.mark.nightly
def test_example_adapter_passes_every_check() -> None:
    """The template of `new-adapter` fails no check, and only its pivot is refused."""
    found = list(findings(Example(), "euler"))
    assert failures(Example(), "euler") == []
    assert {check.name for check, one in found if one.verdict == "not-measured"} == {"pivot"}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    "name",
    [
        "reference:m1",
        pytest.param("reference:euler", marks=pytest.mark.nightly),
        "mujoco:rk4",
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("pybullet:multibody", "dart")),
    ],
)
def test_built_in_adapters_pass_in_their_workers(name: str) -> None:
    """No check of a built-in engine fails, continuous loads as the first request of a kernel included."""
    engine = name.partition(":")[0]
    pytest.importorskip(distribution_of(engine) or "bodycheck")
    found = check_adapter(name, timeout_s=TIMEOUT_S)
    assert [(result.check, result.message) for result in found.failures] == []
    of_methods = [result for result in found.results if result.method != "(trees)"]
    passed = {result.check for result in of_methods if result.verdict == "consistent"}
    assert passed == {check.name for check in CHECKS}
    of_trees = {result.check for result in found.results if result.verdict == "consistent"} - passed
    assert of_trees >= ({"mass matrix", "accelerations", "poses"} if engine != "reference" else set())


class FreeOnly(Example):
    """Refuses loads and gravity, and makes a simulation of the given class."""

    def __init__(self, made: type[ExampleSimulation]) -> None:
        self.made = made

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Accept a free body only."""
        return (
            "only a free body" if scene.loads or scene.gravity.any() else super().unsupported(scene, method)
        )

    def build(self, scene: Scene, method: str, dt_s: float) -> ExampleSimulation:  # noqa: ARG002 - the contract
        """Build the given simulation."""
        return self.made(scene, dt_s)


class KeepsOmega(ExampleSimulation):
    """Resets everything but the angular velocity."""

    def reset(self) -> None:
        """Keep omega, after the first time."""
        omega = getattr(self, "omega", None)
        super().reset()
        if omega is not None:
            self.omega = omega


FREE_FAULTS = {
    name: fault
    for name, fault in FAULTS.items()
    if fault.check in ("read-back", "readings", "free motion", "advance")
}


@pytest.mark.slow
def test_engine_without_loads_and_gravity_passes_on_what_it_accepts() -> None:
    """All checks that need no load pass, also the one after a refused case."""
    found = list(findings(FreeOnly(ExampleSimulation), "euler"))
    assert [one.message for _, one in found if one.verdict == "inconsistent"] == []
    passed = {check.name for check, one in found if one.verdict == "consistent"}
    assert passed >= {"model", "read-back", "readings", "free motion", "reset", "advance", "bad input"}


@pytest.mark.slow(after=1)
@pytest.mark.nightly(after=2)
@pytest.mark.parametrize("name", [*FREE_FAULTS, "omega kept"])
def test_mistake_of_an_engine_without_loads_and_gravity_is_found(name: str) -> None:
    """Its mistakes are found as those of other engines."""
    made, expected = (
        (KeepsOmega, "reset") if name == "omega kept" else (FAULTS[name].simulation, FAULTS[name].check)
    )
    found = findings(FreeOnly(made), "euler")
    assert expected in {check.name for check, one in found if one.verdict == "inconsistent"}


class LateAfterReset(ExampleSimulation):
    """Begins a second motion a microsecond after the first one."""

    def __init__(self, scene: Scene, dt_s: float) -> None:
        self.late_s = 0.0
        super().__init__(scene, dt_s)

    def reset(self) -> None:
        """Restore the initial state, but not the time."""
        super().reset()
        self.steps, self.late_s = self.late_s / self.dt_s, 1e-6


def test_a_small_difference_after_reset_is_not_round_off() -> None:
    """A free velocity that fits into float32 does not make an engine one of single precision."""
    late = FaultyExample(AdapterFault(LateAfterReset, "reset", ""))
    reset = [check for check in CHECKS if check.name == "reset"]
    found = {finding.check: finding.verdict for _, finding in findings(late, "euler", reset)}
    assert found == {"reset": "consistent", "reset_of_time": "inconsistent"}


class Crashing(Example):
    """An engine that raises where a case has a link."""

    def build(self, scene: Scene, method: str, dt_s: float) -> ExampleSimulation:
        """Raise if there is a link."""
        if scene.link is not None:
            raise RuntimeError("links are not written yet")
        return super().build(scene, method, dt_s)


@pytest.mark.nightly
def test_crash_is_a_failure_with_status_1(tmp_path: Path) -> None:
    """A failed case is not a refusal: its checks fail with the engine's own words, and the status is 1."""
    with registered(Crashing()):
        reported = run_bodycheck(tmp_path, "check-adapter", "example", "--quiet", "--json")
    assert reported.returncode == 1
    failed = [one for one in json.loads(reported.stdout)["results"] if one["verdict"] == "inconsistent"]
    assert {one["check"] for one in failed} == {"model", "link"}
    assert all("links are not written yet" in one["message"] for one in failed)


@pytest.mark.nightly
def test_package_of_a_new_adapter_passes_its_own_tests(tmp_path: Path) -> None:
    """`new-adapter` writes an adapter of under 45 lines of code, whose tests pass as they are."""
    made = run_bodycheck(tmp_path, "new-adapter", "my-engine", "--json")
    assert made.returncode == 0, made.stderr
    folder = tmp_path / json.loads(made.stdout)["folder"]
    code = (folder / "bodycheck_my_engine" / "__init__.py").read_text()
    without_docstrings = re.sub(r'""".*?"""', "", code, flags=re.DOTALL)
    lines = [line for line in without_docstrings.splitlines() if line.strip() and line.strip()[0] != "#"]
    assert len(lines) < 45
    facts = tomllib.loads((folder / "pyproject.toml").read_text())
    assert facts["project"]["entry-points"]["bodycheck.adapters"] == {
        "my-engine": "bodycheck_my_engine:MyEngine"
    }
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{folder}:{Path(bodycheck.__file__).parents[1]}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", ["My Engine", "mujoco", "there"])
def test_new_adapter_refuses_a_wrong_name(name: str, tmp_path: Path) -> None:
    """An invalid name, the name of an engine and an existing folder are refused, and nothing is written."""
    (tmp_path / "bodycheck-there").mkdir()
    refused = run_bodycheck(tmp_path, "new-adapter", name)
    assert refused.returncode == 2
    assert len(refused.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bodycheck-there"]
