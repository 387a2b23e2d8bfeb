"""How a case comes to its answer: from this run's journal, from the cache, else from the engine."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Protocol

from bodycheck.adapters import protocol
from bodycheck.adapters.contract import Engine
from bodycheck.adapters.drive import Answer, Case
from bodycheck.adapters.protocol import Message
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.storage.cache import Cache
from bodycheck.reports.storage.journal import Journal
from bodycheck.reports.storage.sealed import Entry, key_of


class Askable(Protocol):
    """Engines by name, each of which answers a request, whatever becomes of it."""

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        """Return the engine's answer."""


class Answers:
    """Answers of engines to cases, and laps of their clocks, each asked for once.

    journal: of this run; what is in it is never asked for again. cache: of all runs, None to ask anew; laps
    are never cached. timeout_s: what one case may take.
    """

    def __init__(self, journal: Journal | None, cache: Cache | None, timeout_s: float) -> None:
        self._journal, self._cache, self._timeout_s = journal, cache, timeout_s

    def ask(self, hosts: Askable, engine: Engine, case: Case) -> Answer:
        """Return what came of a case, whatever became of the engine."""
        key = _key(engine, case, "record")
        message = self._journal.get(key) if self._journal else None
        if message is not None:
            return _read(message, case)
        entry, answer = self._asked(hosts, engine, case, key)
        if self._journal:
            # also what the cache has: it may be gone when the run goes on
            self._journal.append(entry)
        return answer

    def _asked(self, hosts: Askable, engine: Engine, case: Case, key: str) -> tuple[Entry, Answer]:
        # what a user's function does may change under its name
        cache = self._cache if engine.code and not case.scene.has_black_box else None
        if cache and (known := cache.entry(key)):
            return known, _read(known.value, case)
        request = {"do": "record", "case": protocol.case_message(case)}
        message = {**hosts.ask(engine.name, request, self._timeout_s)}
        message.pop("id", None)
        entry, answer = Entry.of(key, message), _read(message, case)
        if cache and _lasting(answer):
            cache.keep(entry)
        return entry, answer

    def laps(self, engine: Engine, case: Case) -> Message | None:
        """Return what this run has measured of a case's speed, if it was before it was interrupted."""
        return self._journal.get(_key(engine, case, "laps")) if self._journal else None

    def keep_laps(self, engine: Engine, case: Case, measured: Message) -> None:
        """Write down what was measured of a case's speed."""
        if self._journal:
            self._journal.put(_key(engine, case, "laps"), measured)


def _read(message: Message, case: Case) -> Answer:
    try:
        return protocol.answer_of(message, case.scene.sample_times)
    except ValueError as error:
        return Answer("failed", protocol.shown(f"{type(error).__name__}: {error}"))


def _lasting(answer: Answer) -> bool:
    """Whether the engine would answer so again: a crash or a timeout may be an accident."""
    return answer.outcome == "unsupported" or (answer.outcome == "ok" and not answer.message)


def _key(engine: Engine, case: Case, what: str) -> str:
    identity: dict[str, Any] = {"name": engine.name, "version": engine.version, "code": engine.code}
    asked = {"method": case.method, **vars(case.setting), "scene": _scene_key(case.scene)}
    return key_of(what=what, protocol=protocol.VERSION, engine=identity, case=asked)


@lru_cache(maxsize=256)  # a scene, which is hashed as the object that it is, has a hundred cases
def _scene_key(scene: Scene) -> str:
    return key_of(scene=protocol.scene_message(scene))
