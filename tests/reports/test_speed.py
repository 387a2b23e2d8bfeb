"""The speed of a case: its fastest lap over that of the reference measurement, despite disturbances."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing

import numpy as np
import pytest

from bodycheck.adapters.contract import Engine
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.runs import speed
from bodycheck.scenarios.library import load_scenario

ENGINE, REFERENCE = "quick", "reference"
LAP_S = {ENGINE: 3e-3, REFERENCE: 1e-3}
STEPS_S = (1e-2, 5e-3)
Lap = Callable[[str, int], Message]
"""Name of an engine, number of laps of the timed engine so far -> its answer to a lap."""
ONE_SCENARIO = ("intermediate-axis", "intermediate-axis")
TWO_SCENARIOS = ("intermediate-axis", "symmetric-top")


def timed(
    monkeypatch: pytest.MonkeyPatch,
    lap: Lap,
    passes: int,
    scenarios: tuple[str, str] = ONE_SCENARIO,
    prepare: Callable[[str], None] = lambda engine: None,  # noqa: ARG005
) -> tuple[list[dict[str, object]], list[int]]:
    """Return the columns of two cases with these laps, and after how many laps each was reported."""
    laps: Counter[str] = Counter()

    class Clockwork:
        """Engines whose laps take the given times."""

        def __init__(self, core: int | None) -> None:
            del core

        def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
            del timeout_s
            if request["do"] == "prepare":
                prepare(engine)
                return {"outcome": "ok"}
            before = laps[ENGINE]
            laps[engine] += 1
            return lap(engine, before)

        def start(self, engine: str) -> None:
            """Nothing to do."""

        def stop(self) -> None:
            """Nothing to do."""

        def close(self) -> None:
            """Nothing to do."""

    monkeypatch.setattr(speed, "EnginePool", Clockwork)
    problems = [Problem.of(load_scenario(name), name) for name in dict.fromkeys(scenarios)]
    about = {"engine": ENGINE, "method": "m", "outcome": "ok", "message": ""}
    cases = [
        CaseResult({**about, "scenario": name, "dt_s": dt_s, "steps": round(10.0 / dt_s)})
        for name, dt_s in zip(scenarios, STEPS_S, strict=True)
    ]
    reported: list[int] = []
    clock = speed.Clock(None)
    clock.warm_up(problems[0].scenario)
    found, noise = speed.measure_speeds(
        problems,
        cases,
        {ENGINE: Engine(ENGINE, "1", {})},
        Answers(None, None, 1.0),
        clock,
        timeout_s=1.0,
        passes=passes,
        case_done=lambda: reported.append(laps[ENGINE]),
    )
    assert noise.spread is None or noise.spread >= 0.0
    return [result.columns for result in found], reported


@pytest.mark.parametrize("passes", [1, 2, 10])
@pytest.mark.parametrize("quiet", [0, -1])
def test_one_quiet_pass_is_enough(passes: int, quiet: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the machine is twice as slow in all passes but one, the speed is unchanged."""
    of_a_case = (3 if passes == 1 else 2) * len(STEPS_S)
    undisturbed = range(passes * of_a_case)[quiet * of_a_case :][:of_a_case]

    def lap(engine: str, number: int) -> Message:
        # the reference, which waits for no memory, is slowed down by less
        slower = 1.0 if number in undisturbed else 2.0 if engine == ENGINE else 1.2
        return {"outcome": "ok", "cpu_s": slower * LAP_S[engine]}

    rows, reported = timed(monkeypatch, lap, passes)
    assert [row["relative_cpu"] for row in rows] == pytest.approx([3.0, 3.0], rel=1e-15, abs=0.0)
    assert reported == [passes * of_a_case // 2, passes * of_a_case]


@pytest.mark.parametrize(
    ("engine_laps", "reference_laps", "timed_laps"),
    [
        ([1.0, 1.0, 1.0], [1.0, 1.0, 1.0], 3),
        ([2.0, 1.01, 1.0], [1.0, 1.3, 1.0], 3),
        ([2.0, 1.0, 1.1, 1.0], [1.0, 1.0, 1.0, 1.0], 4),
        ([1.0, 1.0, 1.0, 1.0], [1.1, 1.0, 1.2, 1.01], 4),
        ([2.0, 1.5, 1.03, 1.0, 4.0], [1.0] * 5, 5),
        ([1.0] * 5, [1.0, 1.1, 1.2, 1.3, 1.4], 5),
    ],
)
def test_timing_ends_once_both_fastest_laps_are_repeated(
    engine_laps: list[float],
    reference_laps: list[float],
    timed_laps: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A case is timed 3 times, and up to 5 until a second lap is within 2 % of the fastest."""
    laps = {ENGINE: engine_laps, REFERENCE: reference_laps}

    def lap(engine: str, number: int) -> Message:
        return {"outcome": "ok", "cpu_s": LAP_S[engine] * laps[engine][number % timed_laps]}

    rows, reported = timed(monkeypatch, lap, 1, TWO_SCENARIOS)
    assert reported == [timed_laps, 2 * timed_laps]
    assert [row["relative_cpu"] for row in rows] == pytest.approx([3.0, 3.0], rel=1e-15, abs=0.0)


@pytest.mark.parametrize(
    ("scenarios", "relative_cpu"), [(ONE_SCENARIO, [3.0, 3.0]), (TWO_SCENARIOS, [3.0, 1.5])]
)
def test_last_reference_lap_also_counts_for_the_next_case_on_its_scenario(
    scenarios: tuple[str, str], relative_cpu: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """If all later reference laps take twice as long, only a case on another scenario appears faster."""
    references: list[int] = []

    def lap(engine: str, number: int) -> Message:
        slower = 1.0
        if engine == REFERENCE:
            references.append(number)
            slower = 1.0 if number < 3 else 2.0
        return {"outcome": "ok", "cpu_s": slower * LAP_S[engine]}

    rows, reported = timed(monkeypatch, lap, 1, scenarios)
    assert [row["relative_cpu"] for row in rows] == pytest.approx(relative_cpu, rel=1e-15, abs=0.0)
    own_laps_of_the_second = reported[1] - reported[0]
    shared = 1 if scenarios == ONE_SCENARIO else 0
    assert len(references) == 3 + own_laps_of_the_second - shared


def test_first_lap_waits_until_the_reference_has_warmed_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference is prepared once, in the background, before anything is timed."""
    log: list[str] = []

    def prepare(engine: str) -> None:
        if engine == REFERENCE:
            time.sleep(0.1)
        log.append(f"prepare {engine}")

    def lap(engine: str, number: int) -> Message:  # noqa: ARG001
        log.append(f"lap {engine}")
        return {"outcome": "ok", "cpu_s": LAP_S[engine]}

    timed(monkeypatch, lap, passes=1, prepare=prepare)
    assert log[0] == f"prepare {REFERENCE}"
    assert log.count(log[0]) == 1


def test_clock_can_be_closed_while_it_warms_up() -> None:
    """A run that ends early leaves no thread behind."""
    before = threading.active_count()
    with closing(speed.Clock(None)) as clock:
        clock.warm_up(load_scenario("intermediate-axis"))
    assert threading.active_count() == before


def test_median_and_quartiles_are_of_all_laps(monkeypatch: pytest.MonkeyPatch) -> None:
    """cpu_s and ns_per_step are of all laps of all passes, with numpy's quantiles."""

    def lap(engine: str, number: int) -> Message:
        return {"outcome": "ok", "cpu_s": LAP_S[engine] * (1.0 + number)}

    rows, _ = timed(monkeypatch, lap, passes=2)
    for place, (row, dt_s) in enumerate(zip(rows, STEPS_S, strict=True)):
        laps = LAP_S[ENGINE] * (1.0 + np.array([0, 1, 4, 5]) + 2 * place)
        shown = [row[name] for name in ("cpu_s_low", "cpu_s", "cpu_s_high")]
        assert shown == pytest.approx(np.quantile(laps, [0.25, 0.5, 0.75]).tolist(), rel=1e-14, abs=0.0)
        assert row["ns_per_step"] == pytest.approx(1e9 * np.median(laps) * dt_s / 10.0, rel=1e-14, abs=0.0)


@pytest.mark.parametrize("lost", [range(2), range(4, 6)], ids=["first", "last"])
def test_lost_pass_does_not_change_the_speed(lost: range, monkeypatch: pytest.MonkeyPatch) -> None:
    """The case has the speed of its other passes, without a message."""

    def lap(engine: str, number: int) -> Message:
        if engine == ENGINE and number in lost:
            return {"outcome": "timeout", "message": "no answer within 1 s"}
        return {"outcome": "ok", "cpu_s": LAP_S[engine]}

    rows, _ = timed(monkeypatch, lap, passes=2)
    assert [(row["relative_cpu"], row["message"]) for row in rows] == [(pytest.approx(3.0), "")] * 2


def test_case_without_a_pass_has_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """The case keeps its measures, has no speed, and its message has the reason once."""

    def lap(engine: str, number: int) -> Message:
        del number
        return {"outcome": "timeout", "message": f"{engine} gave no answer within 1 s"}

    rows, reported = timed(monkeypatch, lap, passes=3)
    assert all("cpu_s" not in row and "relative_cpu" not in row for row in rows)
    assert [row["message"] for row in rows] == ["speed not measured: quick gave no answer within 1 s"] * 2
    assert len(reported) == len(STEPS_S)


def test_reference_below_the_clock_resolution_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """The case has its own time and no ratio."""

    def lap(engine: str, number: int) -> Message:
        del number
        return {"outcome": "ok", "cpu_s": LAP_S[engine] if engine == ENGINE else 0.0}

    rows, _ = timed(monkeypatch, lap, passes=1)
    assert [row["cpu_s"] for row in rows] == [LAP_S[ENGINE]] * 2
    assert all("relative_cpu" not in row for row in rows)
