"""The output of a program with compiled kernels, and with the same kernels interpreted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any


def printed_json(program: str, *, interpreted: bool) -> Any:
    """Return the JSON that a program prints in a separate process."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1" if interpreted else "0"}
    process = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout)
