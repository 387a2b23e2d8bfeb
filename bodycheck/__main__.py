"""The command `bodycheck`, and `python -m bodycheck`."""

from __future__ import annotations

import atexit
import os
import sys
from contextlib import suppress

from bodycheck._util.errors import INPUT, INTERRUPTED, SIGNALLED


def main() -> None:
    """Run the command line; report an interrupt or an error during its import in one line too."""
    if sys.platform == "win32":  # no signals, file locks and process limits as bodycheck needs them
        sys.stderr.write("bodycheck runs on Linux, and not on Windows itself: use it in WSL\n")
        sys.exit(INPUT)
    statuses: list[int] = []
    # an interrupt inside exec() makes CPython kill itself by SIGINT at the end, although it was caught
    atexit.register(_end_with, statuses)
    try:
        from bodycheck.cli.commands import main as command

        command()
    except SystemExit as error:
        if isinstance(error.code, int) and error.code > SIGNALLED:
            statuses.append(error.code)
        raise
    except KeyboardInterrupt:
        sys.stderr.write("stopped before anything started\n")
        sys.exit(INTERRUPTED)
    except Exception as error:  # noqa: BLE001 - importing the command line failed
        from bodycheck.cli._app import report_fault

        sys.exit(report_fault(error, "bodycheck"))


def _end_with(statuses: list[int]) -> None:
    """End this process with the status, if there is one; everything else that runs at exit has run before."""
    if not statuses:
        return
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # it may be closed
            stream.flush()
    os._exit(statuses[0])


if __name__ == "__main__":
    main()
