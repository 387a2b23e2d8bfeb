"""Answers: each request is sent once, and only repeatable answers are stored for other runs."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodycheck import examine, reports
from bodycheck._util.file_digests import digest_of
from bodycheck.adapters.contract import Build, BuildKind, Engine, Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.stable_step import StableStepSearch
from bodycheck.adapters.workers import protocol, received_messages
from bodycheck.adapters.workers.case_messages import case_message, search_message
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.reference_impl.scene import CallbackLoad, RigidBody, Scene, State
from bodycheck.reports.cache import answers as module
from bodycheck.reports.cache.answers import Answers, EngineClient, Reuse
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.journal import Journal
from tests.helpers.expected_messages import ExpectedMessage

START = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.3, 1.0, 0.2]))
SCENE = Scene(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])), START, (), np.zeros(3), 1.0, 3)
CASE = Case(SCENE, "m1", Setting(dt_s=0.1))
LOAD = CallbackLoad("loads:f", lambda t, x, r, v, w: (-v, -w))  # noqa: ARG005 - the contract's arguments
CALLING = replace(CASE, scene=replace(SCENE, loads=(LOAD,)))
ENGINE = Engine("counted", "1", {}, Build("c0de", "installed"))
GOOD = protocol.answer_message(record(Reference(), CASE))


class Counting(EnginePool):
    """An EnginePool of an engine that gives the same answer to every request, and counts them."""

    def __init__(self, returned: dict[str, Any]) -> None:
        super().__init__()
        self.returned, self.requested = returned, 0

    def ask(self, engine: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:  # noqa: ARG002
        """Answer."""
        self.requested += 1
        return {"id": self.requested, **self.returned}


def requests_of_two_runs(returned: dict[str, Any], cache: Cache | None, engine: Engine = ENGINE) -> int:
    """Return how many requests an engine gets in two runs of the same case."""
    engine_pool = Counting(returned)
    first, again = (Answers(None, cache, 1.0).ask(engine_pool, engine, CASE) for _ in range(2))
    assert (first.outcome, first.message) == (again.outcome, again.message)
    return engine_pool.requested


SHORT = {**GOOD, "trajectory": {**GOOD["trajectory"], "t_s": protocol.packed(np.zeros(2))}}
LASTING = {"ok": GOOD, "unsupported": {"outcome": "unsupported", "message": "no pivot"}}
PASSING = {
    "failed": {"outcome": "failed", "message": "it crashed"},
    "timeout": {"outcome": "timeout", "message": "it was late"},
    "no outcome": {},
    "an outcome that is none": {"outcome": ["ok"]},
    "without its parts": {"outcome": "ok"},
    "not at the samples": {**GOOD, "trajectory": {**GOOD["trajectory"], "t_s": protocol.packed(np.ones(3))}},
    "of wrong shapes": SHORT,
    "with a wrong stepping": {**GOOD, "stepping": "sideways"},
    "with wrong steps": {**GOOD, "steps": "many"},
    "with steps without end": {**GOOD, "steps": 10**400},
    "with a mass without end": {**GOOD, "read_back": {**GOOD["read_back"], "mass": 10**400}},
    "with a mass that is a text": {**GOOD, "read_back": {**GOOD["read_back"], "mass": "1"}},
    "with an inertia of five": {
        **GOOD,
        "read_back": {**GOOD["read_back"], "inertia": protocol.packed(np.ones(5))},
    },
    "with a state of its own": {
        **GOOD,
        "read_back": {**GOOD["read_back"], "state": {"mood": protocol.packed(np.ones(3))}},
    },
    "with an array as large as you like": {
        **GOOD,
        "trajectory": {**GOOD["trajectory"], "t_s": {"shape": [10**9, 10**9], "base64": ""}},
    },
    "with a shape that is none": {
        **GOOD,
        "trajectory": {**GOOD["trajectory"], "t_s": {"shape": "3", "base64": ""}},
    },
    "with an array that nobody knows": {
        **GOOD,
        "trajectory": {**GOOD["trajectory"], "spin": protocol.packed(np.zeros(3))},
    },
    "answered by a second run": {**GOOD, "message": "ran twice; first it crashed"},
}


SEARCHES = {
    "no step": {"stable_s": None, "unstable_s": None},
    "a step without end": {"stable_s": 10**400, "unstable_s": None},
    "not a number": {"stable_s": float("nan"), "unstable_s": None},
    "in the wrong order": {"stable_s": 0.2, "unstable_s": 0.1},
    "below zero": {"stable_s": -0.1, "unstable_s": None},
    "a text": {"stable_s": "0.1", "unstable_s": None},
}


@pytest.mark.parametrize("what", SEARCHES)
def test_invalid_search_is_a_failure_with_a_reason(what: str) -> None:
    """An invalid step of a worker reaches no table."""
    returned = {"outcome": "ok", "message": "", "reason": "", **SEARCHES[what]}
    found = Answers(None, None, 1.0).search(
        Counting(returned), ENGINE, StableStepSearch(CASE, 0.01, 1.0, 1.0)
    )
    assert (found.outcome, found.stable_s) == ("failed", None)
    assert found.message


@pytest.mark.parametrize("seconds", [10**400, 1e308, -1.0, float("nan"), "1", None, True, []])
def test_invalid_lap_is_refused(seconds: Any, expected_message: ExpectedMessage) -> None:
    """Only a finite time of a plausible length is a lap."""
    with expected_message.raises(protocol.ProtocolError):
        received_messages.lap_of({"outcome": "ok", "cpu_s": seconds})


def test_only_what_was_checked_is_stored(tmp_path: Path) -> None:
    """Other keys of a message are not written to the journal."""
    nested: Any = []
    for _ in range(2000):  # more than JSON can be written with
        nested = [nested]
    for returned in ({**GOOD, "more": nested}, {"outcome": "failed", "message": "x", "more": nested}):
        with Journal(tmp_path / returned["outcome"]) as journal:
            Answers(journal, None, 1.0).ask(Counting(returned), ENGINE, CASE)
        assert b"more" not in (tmp_path / returned["outcome"]).read_bytes()


@pytest.mark.parametrize("what", LASTING)
def test_repeatable_answer_is_requested_once(what: str, tmp_path: Path) -> None:
    """The second run reads it from the cache."""
    assert requests_of_two_runs(LASTING[what], Cache(tmp_path)) == 1


@pytest.mark.parametrize("what", PASSING)
def test_failure_is_requested_again(what: str, tmp_path: Path) -> None:
    """Failures and invalid answers are not stored for other runs; an invalid answer is a failure."""
    assert requests_of_two_runs(PASSING[what], Cache(tmp_path)) == 2
    answer = Answers(None, None, 1.0).ask(Counting(PASSING[what]), ENGINE, CASE)
    assert answer.outcome in ("failed", "timeout") or what == "answered by a second run"
    assert answer.message


def test_engine_without_identity_is_always_run(tmp_path: Path) -> None:
    """Without an identity of its build, answers cannot be reused."""
    assert requests_of_two_runs(GOOD, Cache(tmp_path), replace(ENGINE, build=Build("", "installed"))) == 2


REUSES = {"nothing": (), "truths": (), "installed": ("installed",)}
KINDS: tuple[BuildKind, ...] = ("installed", "development", "plug-in", "handed over")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("reuse", ["nothing", "truths", "installed", "everything"])
def test_answers_are_reused_of_allowed_engines_only(kind: BuildKind, reuse: Reuse, tmp_path: Path) -> None:
    """By default answers of installed engines are reused, on request of all, never of an object in memory."""
    engine_pool, engine = Counting(GOOD), replace(ENGINE, build=Build("c0de", kind))
    Answers(None, Cache(tmp_path), 1.0).ask(engine_pool, engine, CASE)
    answer = Answers(None, Cache(tmp_path), 1.0, reuse=reuse).ask(engine_pool, engine, CASE)
    allowed = kind in REUSES.get(reuse, KINDS[:3])
    assert answer.reused is allowed
    assert engine_pool.requested == (1 if allowed else 2)


@pytest.mark.parametrize(("returned", "requested"), [({}, 1), ({"build": "c0de"}, 1), ({"build": "0dd"}, 2)])
def test_answer_of_another_build_is_not_stored(
    returned: dict[str, Any], requested: int, tmp_path: Path
) -> None:
    """An engine may be rebuilt, or load more code, while a run continues."""
    assert requests_of_two_runs({**GOOD, **returned}, Cache(tmp_path)) == requested
    answer = Answers(None, None, 1.0).ask(Counting({**GOOD, **returned}), ENGINE, CASE)
    assert answer.build == returned.get("build", "")
    assert not answer.reused


def test_build_that_failed_is_named() -> None:
    """An invalid answer or search has the build of the worker that gave it."""
    answers, engine_pool = Answers(None, None, 1.0), Counting({"outcome": "ok", "build": "0dd"})
    answer, found = answers.ask(engine_pool, ENGINE, CASE), answers.search(engine_pool, ENGINE, SEARCH)
    assert [(one.outcome, one.build) for one in (answer, found)] == [("failed", "0dd")] * 2


@pytest.mark.parametrize("cached", [False, True])
def test_resumed_run_distinguishes_its_own_answers(cached: bool, tmp_path: Path) -> None:
    """An answer of its journal is `reused` only if an earlier run gave it."""
    cache, engine_pool = Cache(tmp_path / "cache"), Counting(GOOD)
    if cached:
        Answers(None, cache, 1.0, run_id="earlier").ask(engine_pool, ENGINE, CASE)
    for _ in range(2):
        with Journal(tmp_path / "journal") as journal:
            answer = Answers(journal, cache, 1.0, run_id="this").ask(engine_pool, ENGINE, CASE)
        assert answer.reused is cached
    assert engine_pool.requested == 1


CHANGES: dict[str, tuple[Engine, Case]] = {
    "engine": (replace(ENGINE, name="other"), CASE),
    "version": (replace(ENGINE, version="2"), CASE),
    "build": (replace(ENGINE, build=Build("c0df", "installed")), CASE),
    "method": (ENGINE, replace(CASE, method="m2")),
    "step": (ENGINE, replace(CASE, setting=Setting(dt_s=float(np.nextafter(0.1, 1.0))))),
    "tolerance": (ENGINE, replace(CASE, setting=Setting(tolerance=0.1))),
    "samples": (ENGINE, replace(CASE, scene=replace(SCENE, samples=2))),
    "gravity": (ENGINE, replace(CASE, scene=replace(SCENE, gravity=np.array([0.0, 0.0, -1e-300])))),
    "body": (
        ENGINE,
        replace(CASE, scene=replace(SCENE, body=replace(SCENE.body, mass=np.nextafter(1.0, 2.0)))),
    ),
}


@pytest.mark.parametrize("what", CHANGES)
def test_any_change_is_requested_again(what: str, tmp_path: Path) -> None:
    """Neither cache nor journal returns the answer of another engine or case."""
    engine_pool, (engine, case) = Counting(GOOD), CHANGES[what]
    with Journal(tmp_path / "journal") as journal:
        Answers(journal, Cache(tmp_path), 1.0).ask(engine_pool, ENGINE, CASE)
    with Journal(tmp_path / "journal") as journal:
        Answers(journal, Cache(tmp_path), 1.0).ask(engine_pool, engine, case)
    assert engine_pool.requested == 2


def test_answer_by_another_protocol_is_requested_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is derived from such answers is derived again, too."""
    engine_pool, answers = Counting(GOOD), Answers(None, Cache(tmp_path), 1.0)
    answers.ask(engine_pool, ENGINE, CASE)
    answers.keep(ENGINE, "the outcome", {"outcome": "ok"}, EngineClient(answers, engine_pool))
    monkeypatch.setattr(protocol, "VERSION", protocol.VERSION + 1)
    assert not answers.ask(engine_pool, ENGINE, CASE).reused
    assert answers.known(ENGINE, "the outcome") is None


def test_derived_rows_depend_on_the_sources_that_derive_them() -> None:
    """The code of all measures and examinations counts."""
    folders = (Path(package.__path__[0]) for package in (reports, examine))
    assert module._code_of_examinations() == [digest_of(folder) for folder in folders]


def test_fresh_run_replaces_the_stored_answers(tmp_path: Path) -> None:
    """The next run reads the new answers."""
    refused = Counting(LASTING["unsupported"])
    Answers(None, Cache(tmp_path), 1.0).ask(Counting(GOOD), ENGINE, CASE)
    Answers(None, Cache(tmp_path).write_only(), 1.0).ask(refused, ENGINE, CASE)
    assert refused.requested == 1
    assert Answers(None, Cache(tmp_path), 1.0).ask(Counting(GOOD), ENGINE, CASE).message == "no pivot"


@pytest.mark.parametrize("what", [*LASTING, *PASSING])
def test_resumed_run_requests_nothing_twice(what: str, tmp_path: Path) -> None:
    """Every answer, failures too, is in the journal and is read as it was."""
    engine_pool = Counting({**LASTING, **PASSING}[what])
    endings = []
    for _ in range(2):
        with Journal(tmp_path / "journal") as journal:
            answer = Answers(journal, None, 1.0).ask(engine_pool, ENGINE, CASE)
            endings.append((answer.outcome, answer.message))
    assert engine_pool.requested == 1
    assert endings[0] == endings[1]


@pytest.mark.parametrize("fresh", [False, True])
def test_resumed_run_does_not_need_the_cache(fresh: bool, tmp_path: Path) -> None:
    """Answers from the cache are in the journal, so the cache may be pruned or removed."""
    cache, engine_pool = Cache(tmp_path / "cache"), Counting(GOOD)
    Answers(None, cache, 1.0).ask(engine_pool, ENGINE, CASE)
    with Journal(tmp_path / "journal") as journal:
        first = Answers(journal, cache.write_only() if fresh else cache, 1.0).ask(engine_pool, ENGINE, CASE)
    requested = engine_pool.requested
    assert requested == (2 if fresh else 1)
    shutil.rmtree(tmp_path / "cache")
    with Journal(tmp_path / "journal") as journal:
        again = Answers(journal, cache, 1.0).ask(engine_pool, ENGINE, CASE)
    assert engine_pool.requested == requested
    assert protocol.answer_message(again) == protocol.answer_message(first)


DERIVED: dict[str, tuple[dict[str, Any], Engine, bool]] = {
    "the same answers": (GOOD, ENGINE, True),
    "a timeout": (PASSING["timeout"], ENGINE, False),
    "a worker with another build": ({**GOOD, "build": "c0df"}, ENGINE, False),
    "an engine without identity": (GOOD, replace(ENGINE, build=Build("", "installed")), False),
    "an editable engine": (GOOD, replace(ENGINE, build=Build("c0de", "editable")), False),
}


@pytest.mark.parametrize("what", DERIVED)
def test_derived_rows_are_reused_where_their_answers_would_be(what: str, tmp_path: Path) -> None:
    """What follows from answers that may change is derived again."""
    returned, engine, reused = DERIVED[what]
    cache = Cache(tmp_path)
    found = Answers(None, cache, 1.0).derived(
        Counting(returned),
        engine,
        "the outcome",
        lambda client: {"outcome": client.ask(engine, CASE).outcome},
    )
    assert found == {"outcome": returned["outcome"]}
    if reused:
        assert Answers(None, cache, 1.0).derived(Counting(returned), engine, "the outcome", None) == found  # type: ignore[arg-type]
    assert requests_of_derivation(engine, cache) == (0 if reused else 1)


def requests_of_derivation(engine: Engine, cache: Cache) -> int:
    """Return how often the function that derives is called."""
    calls: list[None] = []
    Answers(None, cache, 1.0).derived(
        Counting(GOOD),
        engine,
        "the outcome",
        lambda client: {"calls": calls.append(None)},  # noqa: ARG005
    )
    return len(calls)


def test_fresh_run_derives_again(tmp_path: Path) -> None:
    """The newly derived rows replace the stored ones."""
    cache = Cache(tmp_path)
    assert requests_of_derivation(ENGINE, cache) == 1
    assert requests_of_derivation(ENGINE, cache.write_only()) == 1
    assert requests_of_derivation(ENGINE, cache) == 0


def test_laps_are_stored_for_their_run_only(tmp_path: Path) -> None:
    """A speed is read by the run that measured it, and by no other."""
    cache, laps = Cache(tmp_path / "cache"), {"own_s": [1.0], "reference_s": [2.0]}
    with Journal(tmp_path / "journal") as journal:
        Answers(journal, cache, 1.0).keep_laps([(ENGINE, CASE)], [laps])
    with Journal(tmp_path / "journal") as journal:
        assert Answers(journal, cache, 1.0).laps([(ENGINE, CASE)]) == [laps]
    assert Answers(None, cache, 1.0).laps([(ENGINE, CASE)]) is None
    assert not list(tmp_path.glob("cache/*"))


# ---------------------------------------------------------------------------------------------- searches

SEARCH = StableStepSearch(CASE, 0.01, 2.0, 100.0)
FOUND = {"outcome": "ok", "message": "", "stable_s": 0.5, "unstable_s": 0.505, "reason": "K"}


@pytest.mark.parametrize("returned", [FOUND, {**FOUND, "unstable_s": None}, LASTING["unsupported"]])
def test_repeatable_search_is_requested_once(returned: dict[str, Any], tmp_path: Path) -> None:
    """The second run reads it from the cache; another limit is another search."""
    engine_pool, answers = Counting(returned), Answers(None, Cache(tmp_path), 1.0)
    first, again = (answers.search(engine_pool, ENGINE, SEARCH) for _ in range(2))
    assert first == replace(again, reused=False)
    assert again.reused
    assert engine_pool.requested == 1
    answers.search(engine_pool, ENGINE, replace(SEARCH, highest_s=3.0))
    answers.ask(engine_pool, ENGINE, CASE)
    assert engine_pool.requested == 3


def test_search_of_another_build_is_not_stored(tmp_path: Path) -> None:
    """It is requested again, and names the build that gave it."""
    engine_pool, answers = Counting({**FOUND, "build": "0dd"}), Answers(None, Cache(tmp_path), 1.0)
    assert [answers.search(engine_pool, ENGINE, SEARCH).build for _ in range(2)] == ["0dd", "0dd"]
    assert engine_pool.requested == 2


def test_requests_are_those_of_the_protocol(tmp_path: Path) -> None:
    """A motion is recorded, recorded again after a reset or in another process, and a step is searched."""
    requests: list[dict[str, Any]] = []

    class Noting(Counting):
        def ask(self, engine: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:
            assert (engine, timeout_s) == ("counted", 7.5)
            requests.append(request)
            return super().ask(engine, request, timeout_s)

    answers, engine_pool = Answers(None, Cache(tmp_path), 7.5), Noting(GOOD)
    for ask in (answers.ask, answers.replay, answers.elsewhere, answers.sentinel):
        assert ask(engine_pool, ENGINE, CASE).outcome == "ok"
    answers.search(engine_pool, ENGINE, SEARCH)
    recorded = {"do": "record", "case": case_message(CASE)}
    searched = {"do": "stable-step", **search_message(SEARCH)}
    replayed = {**recorded, "do": "replay"}
    assert requests == [recorded, replayed, recorded, recorded, searched]


def test_engine_runs_again_after_reset_and_in_another_process() -> None:
    """Its worker is restarted for the second; every answer counts for what is derived."""
    done: list[str] = []

    class Noting(Counting):
        def ask(self, engine: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:
            done.append(request["do"])
            return super().ask(engine, request, timeout_s)

        def restart(self, engine: str) -> None:
            done.append(f"restart {engine}")

    for returned, lasting in ((GOOD, True), ({**GOOD, "message": "ran twice"}, False)):
        done.clear()
        reported = []
        for place in range(2):
            client = EngineClient(Answers(None, None, 1.0), Noting(returned))
            for at, (how, again) in enumerate(client.again(ENGINE)):
                reported += [how] if place else []
                if at == place:
                    assert again(ENGINE, CASE).outcome == "ok"
            assert client.is_repeatable is lasting
        assert reported == ["after reset", "in another process"]
        assert done == ["replay", "restart counted", "restart counted", "record"]


def test_answer_with_a_user_function_is_not_derived_from() -> None:
    """Nothing is derived, because the code of the function may change."""
    client = EngineClient(Answers(None, None, 1.0), Counting(GOOD))
    assert client.ask(ENGINE, CALLING).outcome == "ok"
    assert not client.is_repeatable


@pytest.mark.parametrize(
    "part", ["own_code", "_code_of_examinations", "numeric_parts", "an engine", "a question"]
)
def test_derived_rows_depend_on_all_code_that_derives_them(
    part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine and the question count too; rows of an engine that may change are not read."""
    answers, client = (
        Answers(None, Cache(tmp_path), 1.0),
        EngineClient(Answers(None, None, 1.0), Counting(GOOD)),
    )
    answers.keep(ENGINE, "the outcome", {"outcome": "ok"}, client)
    assert answers.known(ENGINE, "the outcome") == {"outcome": "ok"}
    if part.startswith("a"):
        engine = replace(ENGINE, name="another") if part == "an engine" else ENGINE
        assert answers.known(engine, "the outcome" if part == "an engine" else "another") is None
    else:
        monkeypatch.setattr(module, part, lambda: "another")
        assert answers.known(ENGINE, "the outcome") is None


def test_sentinel_is_measured_by_every_run(tmp_path: Path) -> None:
    """It tells the machines of a run apart, so that an answer of another run would hide a difference."""
    engine_pool, answers = Counting(GOOD), Answers(None, Cache(tmp_path), 1.0)
    assert not any(answers.sentinel(engine_pool, ENGINE, CASE).reused for _ in range(2))
    assert engine_pool.requested == 2


def test_sentinel_of_a_resumed_run_is_measured_by_it(tmp_path: Path) -> None:
    """The journal may hold the answer of an earlier run to the same case; the sentinel's own one is kept."""
    engine_pool, cache = Counting(GOOD), Cache(tmp_path / "cache")
    Answers(None, cache, 1.0, run_id="earlier").ask(engine_pool, ENGINE, CASE)
    with Journal(tmp_path / "journal") as journal:
        assert Answers(journal, cache, 1.0, run_id="this").ask(engine_pool, ENGINE, CASE).reused
    for _ in range(2):
        with Journal(tmp_path / "journal") as journal:
            answers = Answers(journal, cache, 1.0, run_id="this")
            assert not answers.sentinel(engine_pool, ENGINE, CASE).reused
    assert engine_pool.requested == 2


@pytest.mark.parametrize("returned", [{}, {"outcome": "failed", "message": "it crashed"}, {"outcome": "ok"}])
def test_failed_search_is_requested_again(returned: dict[str, Any], tmp_path: Path) -> None:
    """A failed search has a reason, and the next run requests it again."""
    engine_pool = Counting(returned)
    for _ in range(2):
        found = Answers(None, Cache(tmp_path), 1.0).search(engine_pool, ENGINE, SEARCH)
        assert found.outcome == "failed"
        assert found.message
    assert engine_pool.requested == 2


def test_answer_with_a_user_function_is_not_stored(tmp_path: Path) -> None:
    """The answer is not stored, because the code may change under the same name."""
    engine_pool = Counting(GOOD)
    for _ in range(2):
        with Journal(tmp_path / "journal") as journal:
            answers = Answers(journal, Cache(tmp_path), 1.0)
            assert answers.ask(engine_pool, ENGINE, CALLING).outcome == "ok"
            assert answers.laps([(ENGINE, CALLING)]) is None
            answers.keep_laps([(ENGINE, CALLING)], [{"cpu_s": [0.5]}])
    assert engine_pool.requested == 2
