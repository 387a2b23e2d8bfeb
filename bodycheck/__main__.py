"""The command `bodycheck`, and `python -m bodycheck`."""

from __future__ import annotations

import sys

from bodycheck._util.errors import INTERRUPTED


def main() -> None:
    """Run the command line; report an interrupt or an error during its import in one line too."""
    try:
        from bodycheck.cli.commands import main as command

        command()
    except KeyboardInterrupt:
        sys.stderr.write("stopped before anything started\n")
        sys.exit(INTERRUPTED)
    except Exception as error:  # noqa: BLE001 - importing the command line failed
        from bodycheck.cli._app import report_fault

        sys.exit(report_fault(error, "bodycheck"))


if __name__ == "__main__":
    main()
