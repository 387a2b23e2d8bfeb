"""How a case comes to its answer: from this run's journal, from the cache, else from the engine."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Protocol, TypeVar

from bodycheck.adapters import case_messages, protocol
from bodycheck.adapters.contract import Engine
from bodycheck.adapters.drive import Answer, Case
from bodycheck.adapters.protocol import Message
from bodycheck.adapters.stable_step import Search, StableStep
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.storage.cache import Cache
from bodycheck.reports.storage.journal import Journal
from bodycheck.reports.storage.sealed import Entry, key_of


class Askable(Protocol):
    """Engines by name, each of which answers a request, whatever becomes of it."""

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        """Return the engine's answer."""


_Said = TypeVar("_Said", Answer, StableStep)


class Answers:
    """Answers of engines to cases, and laps of their clocks, each asked for once.

    journal: of this run; what is in it is never asked for again. cache: of all runs, None to ask anew; laps
    are never cached. timeout_s: what one case may take.
    """

    def __init__(self, journal: Journal | None, cache: Cache | None, timeout_s: float) -> None:
        self._journal, self._cache, self._timeout_s = journal, cache, timeout_s

    def ask(self, hosts: Askable, engine: Engine, case: Case) -> Answer:
        """Return what came of a case, whatever became of the engine."""
        return self._answered(
            hosts,
            engine,
            case,
            _key(engine, case, "record"),
            lambda: {"do": "record", "case": case_messages.case_message(case)},
            lambda message: _read(message, case),
        )

    def search(self, hosts: Askable, engine: Engine, search: Search) -> StableStep:
        """Return what came of a search for the largest stable step, whatever became of the engine."""
        return self._answered(
            hosts,
            engine,
            search.case,
            _key(engine, search.case, "stable-step", **case_messages.search_bounds(search)),
            lambda: {"do": "stable-step", **case_messages.search_message(search)},
            _read_search,
        )

    def _answered(
        self,
        hosts: Askable,
        engine: Engine,
        case: Case,
        key: str,
        request: Callable[[], Message],
        read: Callable[[Message], _Said],
    ) -> _Said:
        journal = self._journal_of(case)
        message = journal.get(key) if journal else None
        if message is not None:
            return read(message)
        cache = self._cache if engine.code and not case.scene.has_black_box else None
        entry = cache.entry(key) if cache else None
        if entry is None:
            message = {**hosts.ask(engine.name, request(), self._timeout_s)}
            message.pop("id", None)
            entry, said = Entry.of(key, message), read(message)
            if cache and _lasting(said):
                cache.keep(entry)
        else:
            said = read(entry.value)
        if journal:
            # also what the cache has: it may be gone when the run goes on
            journal.append(entry)
        return said

    def _journal_of(self, case: Case) -> Journal | None:
        """What a user's function does may change under its name, even before a run goes on: none is kept."""
        return None if case.scene.has_black_box else self._journal

    def laps(self, engine: Engine, case: Case) -> Message | None:
        """Return what this run has measured of a case's speed, if it was before it was interrupted."""
        journal = self._journal_of(case)
        return journal.get(_key(engine, case, "laps")) if journal else None

    def keep_laps(self, engine: Engine, case: Case, measured: Message) -> None:
        """Write down what was measured of a case's speed."""
        if journal := self._journal_of(case):
            journal.put(_key(engine, case, "laps"), measured)


def _read(message: Message, case: Case) -> Answer:
    try:
        return protocol.answer_of(message, case.scene.sample_times)
    except ValueError as error:
        return Answer("failed", protocol.shown(f"{type(error).__name__}: {error}"))


def _read_search(message: Message) -> StableStep:
    try:
        return protocol.stable_step_of(message)
    except ValueError as error:
        return StableStep("failed", protocol.shown(f"{type(error).__name__}: {error}"))


def _lasting(answer: Answer | StableStep) -> bool:
    """Whether the engine would answer so again: a crash or a timeout may be an accident."""
    return answer.outcome == "unsupported" or (answer.outcome == "ok" and not answer.message)


def _key(engine: Engine, case: Case, what: str, **within: float | None) -> str:
    identity: dict[str, Any] = {"name": engine.name, "version": engine.version, "code": engine.code}
    asked = {"method": case.method, **vars(case.setting), "scene": _scene_key(case.scene)}
    return key_of(what=what, protocol=protocol.VERSION, engine=identity, case=asked, **within)


@lru_cache(maxsize=256)  # a scene, which is hashed as the object that it is, has a hundred cases
def _scene_key(scene: Scene) -> str:
    return key_of(scene=case_messages.scene_message(scene))
