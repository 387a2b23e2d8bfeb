"""Get the answer to a case from the run's journal, from the cache, or from the engine, in this order.

The cache key includes the identity of the code that the engine's worker has loaded. An answer is cached only
if the worker that gave it had loaded exactly that code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, TypeVar

from bodycheck._util.file_digests import digest_of
from bodycheck._util.platform_identity import numeric_parts
from bodycheck.adapters.contract import Engine
from bodycheck.adapters.execution import Answer, Case
from bodycheck.adapters.registry import own_code, requested_name
from bodycheck.adapters.stable_step import StableStep, StableStepSearch
from bodycheck.adapters.workers import case_messages, protocol, received_messages
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.cache import Reuse
from bodycheck.reports.cache.disk_cache import Cache, Entry, key_of
from bodycheck.reports.cache.journal import Journal

_Result = TypeVar("_Result", Answer, StableStep)


class Answers:
    """Answers of engines to cases, and lap times; each is requested once.

    journal: of this run; its answers are never requested again. cache: shared by all runs, None to disable
    it; laps are never cached. timeout_s: time limit of one case. reuse: which cached answers are used.
    run_id: of this run; it distinguishes this run's answers in the journal from reused ones.
    """

    def __init__(
        self,
        journal: Journal | None,
        cache: Cache | None,
        timeout_s: float,
        *,
        reuse: Reuse = "installed",
        run_id: str = "",
    ) -> None:
        self._journal, self._cache, self._timeout_s = journal, cache, timeout_s
        self._reuse: Reuse = reuse
        self._run_id = run_id

    def ask(self, engine_pool: EnginePool, engine: Engine, case: Case) -> Answer:
        """Return the answer to a case, also where the engine failed."""
        return self._motion(engine_pool, engine, case, "record")

    def replay(self, engine_pool: EnginePool, engine: Engine, case: Case) -> Answer:
        """Return the motion of a second run after `reset`, and the model read back after the first."""
        return self._motion(engine_pool, engine, case, "replay")

    def elsewhere(self, engine_pool: EnginePool, engine: Engine, case: Case) -> Answer:
        """Return the answer to a case that was requested before; the caller has restarted the engine."""
        return self._motion(engine_pool, engine, case, "record", kind="another process")

    def derived(
        self,
        engine_pool: EnginePool,
        engine: Engine,
        topic: Any,
        derive: Callable[[EngineClient], Message],
    ) -> Message:
        """Return what follows from an engine's answers alone, from an earlier run where answers are reused.

        topic: plain data that distinguishes it from all else derived for this engine. derive: computes it, as
        plain data.
        """
        known = self.known(engine, topic)
        if known is not None:
            return known
        client = EngineClient(self, engine_pool)
        found = derive(client)
        self.keep(engine, topic, found, client)
        return found

    def known(self, engine: Engine, topic: Any) -> Message | None:
        """Return what an earlier run derived from the answers of this build, where answers are reused."""
        return self._cache.get(_derived_key(engine, topic)) if self._cache and self._reuses(engine) else None

    def keep(self, engine: Engine, topic: Any, found: Message, client: EngineClient) -> None:
        """Store what was derived from the answers that a client received, if they would be given again."""
        known = engine.build.id and engine.build.kind != "handed over"
        if self._cache and known and client.is_repeatable:
            self._cache.put(_derived_key(engine, topic), found)

    def sentinel(self, engine_pool: EnginePool, engine: Engine, case: Case) -> Answer:
        """Return the answer that this machine gives to a case, never one of another run."""
        return self._motion(engine_pool, engine, case, "record", kind="sentinel", cached=False)

    def _motion(
        self,
        engine_pool: EnginePool,
        engine: Engine,
        case: Case,
        do: str,
        *,
        kind: str = "",
        cached: bool = True,
    ) -> Answer:
        return self._answered(
            engine_pool,
            engine,
            case,
            _key(engine, case, kind or do),
            lambda: {"do": do, "case": case_messages.case_message(case)},
            _reader(lambda message: received_messages.answer_of(message, case.scene.sample_times), Answer),
            cached=cached,
        )

    def search(self, engine_pool: EnginePool, engine: Engine, search: StableStepSearch) -> StableStep:
        """Return the result of a search for the largest stable step, also where the engine failed."""
        do = "stable-step"
        return self._answered(
            engine_pool,
            engine,
            search.case,
            _key(engine, search.case, do, **case_messages.search_bounds(search)),
            lambda: {"do": do, **case_messages.search_message(search)},
            _reader(received_messages.stable_step_of, StableStep),
        )

    def _answered(
        self,
        engine_pool: EnginePool,
        engine: Engine,
        case: Case,
        key: str,
        request: Callable[[], Message],
        read: Callable[[Message], _Result],
        *,
        cached: bool = True,
    ) -> _Result:
        journal = self._journal_of(case)
        message = journal.get(key) if journal else None
        if message is not None:
            return replace(read(message), reused=message.get("run") != self._run_id)
        cache = self._cache_of(engine, case) if cached else None
        entry = cache.entry(key) if cache and self._reuses(engine) else None
        reused = entry is not None
        if entry is None:
            message = {**engine_pool.ask(engine.name, request(), self._timeout_s), "run": self._run_id}
            result = read(message)
            entry = Entry.of(key, received_messages.stored_part(message, result))
            if cache and _is_repeatable(result) and message.get("build", engine.build.id) == engine.build.id:
                cache.keep(entry)
        else:
            result = read(entry.value)
        if journal:
            # cached answers too: the cache may be gone when the run is resumed
            journal.append(entry)
        return replace(result, reused=reused)

    def _cache_of(self, engine: Engine, case: Case) -> Cache | None:
        """Return the cache; None where the engine is not identified, or a user's function may change."""
        known = engine.build.id and engine.build.kind != "handed over"
        return self._cache if known and not case.scene.has_callback_load else None

    def _reuses(self, engine: Engine) -> bool:
        return self._reuse == "everything" or (
            self._reuse == "installed" and engine.build.kind == "installed"
        )

    def _journal_of(self, case: Case) -> Journal | None:
        """Return the journal; None where a user's function may change before the run is resumed."""
        return None if case.scene.has_callback_load else self._journal

    def laps(self, timed: Sequence[tuple[Engine, Case]]) -> list[Message] | None:
        """Return the laps of all these cases if this run measured them before it was interrupted."""
        found = self._journal.get(_laps_key(timed)) if self._journal else None
        return None if found is None else found["laps"]

    def keep_laps(self, timed: Sequence[tuple[Engine, Case]], measured: Sequence[Message]) -> None:
        """Store the laps of all cases in the journal at once, so that they stem from one sitting."""
        if self._journal and not any(case.scene.has_callback_load for _, case in timed):
            self._journal.put(_laps_key(timed), {"laps": list(measured)})


class EngineClient:
    """The answers that one pool gives. is_repeatable: whether every engine would answer the same again."""

    def __init__(self, answers: Answers, engine_pool: EnginePool) -> None:
        self._answers, self._engine_pool = answers, engine_pool
        self.is_repeatable = True

    def ask(self, engine: Engine, case: Case) -> Answer:
        """Return the answer to a case."""
        return self._recorded(engine, case, self._answers.ask(self._engine_pool, engine, case))

    def replay(self, engine: Engine, case: Case) -> Answer:
        """Return the motion of a second run after `reset`."""
        return self._recorded(engine, case, self._answers.replay(self._engine_pool, engine, case))

    def again(self, engine: Engine) -> Iterator[tuple[str, Callable[[Engine, Case], Answer]]]:
        """Yield the ways to run cases of an engine again, in words and as a function."""
        yield "after reset", self.replay
        self._engine_pool.restart(engine.name)
        yield "in another process", self._elsewhere

    def _elsewhere(self, engine: Engine, case: Case) -> Answer:
        return self._recorded(engine, case, self._answers.elsewhere(self._engine_pool, engine, case))

    def _recorded(self, engine: Engine, case: Case, answer: Answer) -> Answer:
        same_build = answer.build in ("", engine.build.id)
        # a user's function may change
        self.is_repeatable &= _is_repeatable(answer) and same_build and not case.scene.has_callback_load
        return answer


def _reader(parse: Callable[[Message], _Result], kind: type[_Result]) -> Callable[[Message], _Result]:
    """Return what reads messages of a kind; one that cannot be parsed is a failure of the engine."""

    def read(message: Message) -> _Result:
        try:
            return replace(parse(message), build=_build(message))
        except ValueError as error:
            message_text = protocol.one_line(f"{type(error).__name__}: {error}")
            return kind("failed", message_text, build=_build(message))

    return read


def _build(message: Message) -> str:
    return protocol.one_line(str(message.get("build", "")))


def _is_repeatable(answer: Answer | StableStep) -> bool:
    """Whether the engine would answer the same again; a crash or a timeout may be accidental."""
    return answer.outcome == "unsupported" or (answer.outcome == "ok" and not answer.message)


def _key(engine: Engine, case: Case, kind: str, **within: float | None) -> str:
    setting = [case.method, vars(case.setting), scene_key(case.scene)]
    return key_of(kind=kind, protocol=protocol.VERSION, engine=_identity(engine), case=setting, **within)


def _laps_key(timed: Sequence[tuple[Engine, Case]]) -> str:
    return key_of(laps=[_key(engine, case, "laps") for engine, case in timed])


def _identity(engine: Engine) -> list[str]:
    return [requested_name(engine.name), engine.version, engine.build.id]


def _derived_key(engine: Engine, topic: Any) -> str:
    code = [own_code(), *_code_of_examinations(), numeric_parts()]
    return key_of(derived=topic, protocol=protocol.VERSION, engine=_identity(engine), code=code)


@cache
def _code_of_examinations() -> list[str]:
    package = Path(__file__).parents[2]
    return [digest_of(package / room) for room in ("reports", "examine")]


@lru_cache(maxsize=256)  # a scene, hashed by identity, has about a hundred cases
def scene_key(scene: Scene) -> str:
    """Return a hash of all that an engine is given of a scene."""
    return key_of(scene=case_messages.scene_message(scene))
