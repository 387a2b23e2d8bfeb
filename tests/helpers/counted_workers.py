"""A plugin for tools/coverage.sh: which lines workers and each test executed.

coverage stores the lines of a worker on SIGTERM (`sigterm` in pyproject.toml); a run sends SIGKILL, which
prevents that. The context of a line is the test, by which tools/mutation_trials.py finds the tests of a line.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Generator
from contextlib import suppress

import coverage
import pytest

from bodycheck.adapters.workers.worker_process import WorkerProcess

_STORING_S = 5.0
_kill = WorkerProcess.kill


def _ended(worker: WorkerProcess) -> None:
    if worker._open:
        with suppress(ProcessLookupError):
            os.kill(worker.pid, signal.SIGTERM)
        end = time.monotonic() + _STORING_S
        while worker._process.poll() is None and time.monotonic() < end:
            time.sleep(0.01)
    _kill(worker)


def pytest_configure() -> None:
    """Replace the function that ends a worker, in each process of pytest-xdist."""
    WorkerProcess.kill = _ended  # type: ignore[method-assign]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Name the test to coverage, with its fixtures."""
    running = coverage.Coverage.current()
    assert running is not None
    running.switch_context(item.nodeid)
    return (yield)
