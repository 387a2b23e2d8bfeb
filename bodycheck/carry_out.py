"""Carrying a command line out: what the user can put right ends it with a line and a status."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from bodycheck.errors import INTERRUPTED, BodycheckError, StoppedError

if TYPE_CHECKING:
    import typer


def carry_out(app: typer.Typer, name: str) -> None:
    """Run an app under a name; wrong input ends with status 2, an interrupt with 130, each told."""
    try:
        app(prog_name=name)
    except BodycheckError as error:
        print(error, file=sys.stderr)
        sys.exit(INTERRUPTED if isinstance(error, StoppedError) else 2)
