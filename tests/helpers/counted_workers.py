"""A plugin for tools/coverage.sh: engine workers store which lines they executed before they are killed.

coverage stores them on SIGTERM (`sigterm` in pyproject.toml); a run sends SIGKILL, which prevents that.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress

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
