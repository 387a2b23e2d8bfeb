"""Sharing work out to strands that run side by side, each with workers of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bodycheck.adapters.workers.engine_pool import Hosts


@dataclass(frozen=True, eq=False)
class Task:
    """Work with one engine: what it will cost, in any unit, and what to do with a strand's hosts."""

    engine: str
    cost: float
    do: Callable[[Hosts], None]


class _Board:
    """What is still to be done; the dearest first, and with an engine that the strand has running already."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._open = sorted(tasks, key=lambda task: task.cost)
        self._lock = threading.Lock()

    def next(self, hosts: Hosts) -> Task | None:
        with self._lock:
            if not self._open:
                return None
            running = [i for i, task in enumerate(self._open) if task.engine in hosts]
            return self._open.pop(running[-1] if running else self._farthest_behind())

    def _farthest_behind(self) -> int:
        """Return the dearest task of the engine with the most work left."""
        left: dict[str, float] = {}
        for task in self._open:
            left[task.engine] = left.get(task.engine, 0.0) + task.cost
        behind = max(left, key=lambda engine: left[engine])
        return max(i for i, task in enumerate(self._open) if task.engine == behind)

    def clear(self) -> None:
        with self._lock:
            self._open.clear()


def share_out(tasks: Sequence[Task], jobs: int) -> None:
    """Do all tasks, `jobs` of them at a time.

    What one of them raises ends the others and is raised here; so does an interrupt from the keyboard.
    """
    board, raised = _Board(tasks), []
    strands = [Hosts() for _ in range(max(1, min(jobs, len(tasks))))]
    ended = threading.Semaphore(0)

    def work(hosts: Hosts) -> None:
        try:
            while task := board.next(hosts):
                task.do(hosts)
        except BaseException as error:  # noqa: BLE001 - raised again by the thread that waits
            raised.append(error)
            board.clear()
        finally:
            hosts.close()
            ended.release()

    threads = [threading.Thread(target=work, args=(hosts,), daemon=True) for hosts in strands]
    for thread in threads:
        thread.start()
    try:
        for _ in threads:
            ended.acquire()
    finally:
        board.clear()
        for hosts in strands:
            hosts.stop()
        for thread in threads:
            thread.join()
    if raised:
        raise raised[0]
