"""Run tasks on parallel threads, each with its own workers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bodycheck.adapters.workers.engine_pool import EnginePool, RemoteEngines


@dataclass(frozen=True, eq=False)
class Task:
    """Work with one engine: its expected cost, in any unit, and what to do with a thread's engine pool."""

    engine: str
    cost: float
    do: Callable[[EnginePool], None]


class _TaskQueue:
    """The remaining tasks, most expensive first; tasks of an engine that the thread already runs go first."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._open = sorted(tasks, key=lambda task: task.cost)
        self._lock = threading.Lock()

    def next(self, engine_pool: EnginePool) -> Task | None:
        with self._lock:
            if not self._open:
                return None
            running = [i for i, task in enumerate(self._open) if task.engine in engine_pool]
            return self._open.pop(running[-1] if running else self._farthest_behind())

    def _farthest_behind(self) -> int:
        """Return the index of the most expensive task of the engine with the most work left."""
        left: dict[str, float] = {}
        for task in self._open:
            left[task.engine] = left.get(task.engine, 0.0) + task.cost
        behind = max(left, key=lambda engine: left[engine])
        return max(i for i, task in enumerate(self._open) if task.engine == behind)

    def clear(self) -> None:
        with self._lock:
            self._open.clear()


def run_tasks(tasks: Sequence[Task], jobs: int, remote: RemoteEngines | None = None) -> None:
    """Run all tasks, `jobs` at a time; remote: engines elsewhere, which answer instead of worker processes.

    An exception in one task ends the others and is raised here, and so is a keyboard interrupt.
    """
    queue, raised = _TaskQueue(tasks), []
    # with the GIL, two threads that measure would only take turns within each sample
    gil_lock = threading.Lock()
    engine_pools = [EnginePool(turn=gil_lock, remote=remote) for _ in range(max(1, min(jobs, len(tasks))))]
    ended = threading.Semaphore(0)

    def work(engine_pool: EnginePool) -> None:
        try:
            while task := queue.next(engine_pool):
                with gil_lock:
                    task.do(engine_pool)
        except BaseException as error:  # noqa: BLE001 - raised again by the waiting thread
            raised.append(error)
            queue.clear()
        finally:
            engine_pool.close()
            ended.release()

    threads = [
        threading.Thread(target=work, args=(engine_pool,), daemon=True) for engine_pool in engine_pools
    ]
    for thread in threads:
        thread.start()
    try:
        for _ in threads:
            ended.acquire()
    finally:
        queue.clear()
        if remote is not None:
            remote.stop()
        for engine_pool in engine_pools:
            engine_pool.stop()
        for thread in threads:
            thread.join()
    if raised:
        raise raised[0]
