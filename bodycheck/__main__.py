"""The command `bodycheck`, and `python -m bodycheck`."""

from __future__ import annotations

import sys

from bodycheck.errors import INTERRUPTED


def main() -> None:
    """Carry the command out; an interrupt while it is still being imported ends it in one line too."""
    try:
        from bodycheck.cli import main as command

        command()
    except KeyboardInterrupt:
        sys.stderr.write("stopped, before anything began\n")
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
