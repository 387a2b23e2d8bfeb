"""The command of a Python that imports what this process can, and nothing from the working directory."""

from __future__ import annotations

import os
import sys


def child_python(module: str, *arguments: str) -> tuple[list[str], dict[str, str]]:
    """Return the command that runs a module in a process of its own, and the variables to add for it.

    Without -P, `python -m` would search the working directory first, where anybody's numpy.py may lie.
    """
    variables = {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return [sys.executable, "-P", "-m", module, *arguments], variables
