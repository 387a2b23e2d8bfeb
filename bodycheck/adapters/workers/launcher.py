"""Limit a process that serves a run: limit its memory, and end it with the run.

Run as `python -I THIS_FILE MEMORY_BYTES COMMAND...` to replace this process by a program that has these
limits. It imports the standard library only, because it runs before each such program.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
from contextlib import suppress
from pathlib import Path

_PR_SET_PDEATHSIG = 1
RUN_PID = "BODYCHECK_RUN_PID"
"""Environment variable of a worker: the process id of its run. A worker refuses to start a run."""


def die_with_the_run() -> None:
    """Make Linux kill this process when the run dies, because a hanging engine never reads its input."""
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if RUN_PID in os.environ and not _is_alive(os.environ[RUN_PID]):  # the run died before the call
        sys.exit(1)


def _is_alive(pid: str) -> bool:
    """Return whether a process exists and is not a zombie."""
    try:
        return Path("/proc", pid, "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def limit_memory(size: int) -> None:
    """Make allocations beyond the limit fail, and let the out-of-memory killer choose this process first."""
    _, hard_limit = resource.getrlimit(resource.RLIMIT_DATA)
    limit = size if hard_limit == resource.RLIM_INFINITY else min(size, hard_limit)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


def main() -> None:
    """Become the program; exit with status 127 if it cannot be started."""
    die_with_the_run()
    limit_memory(int(sys.argv[1]))
    try:
        os.execvp(sys.argv[2], sys.argv[2:])
    except OSError as error:
        print(f"{sys.argv[2]}: {error.strerror}", file=sys.stderr)
        sys.exit(127)


if __name__ == "__main__":
    main()
