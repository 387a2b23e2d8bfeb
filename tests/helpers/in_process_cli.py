"""Commands of bodycheck run in this process, because starting an interpreter takes longer than most do."""

from __future__ import annotations

import gc
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from subprocess import CompletedProcess
from unittest.mock import patch

from bodycheck.cli.commands import main


def run_bodycheck(folder: Path, *words: str) -> CompletedProcess[str]:
    """Run `bodycheck words` in a folder and return the result; modules imported from there are removed."""
    out, err = StringIO(), StringIO()
    status: object = None
    collected_after = gc.get_threshold()
    with (
        chdir(folder),
        redirect_stdout(out),
        redirect_stderr(err),
        patch.object(sys, "argv", ["bodycheck", *words]),
        patch.object(sys, "path", [str(folder), *sys.path]),
    ):
        try:
            main()
        except SystemExit as ended:
            status = ended.code
        finally:
            gc.set_threshold(*collected_after)
    for name, module in list(sys.modules.items()):
        is_ours = name.partition(".")[0] in ("bodycheck", "tests")  # the folder may be that of the project
        if not is_ours and Path(getattr(module, "__file__", None) or "/").is_relative_to(folder):
            del sys.modules[name]
    return CompletedProcess(["bodycheck", *words], int(str(status or 0)), out.getvalue(), err.getvalue())
