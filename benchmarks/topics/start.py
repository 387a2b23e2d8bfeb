"""The first `bodycheck truth` of a machine, which compiles, and the later ones: whole processes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.effort import Effort
from benchmarks.figures import Measured
from benchmarks.timing import Spread

_COMMAND = (sys.executable, "-m", "bodycheck", "truth", "intermediate-axis", "--at")

_TREE = Path(__file__).parents[2]  # python -m finds the package of this very tree there


def start(effort: Effort) -> list[Measured]:
    """Measure a free truth from an empty folder, then others: at times whose answer is kept nowhere."""
    if effort.starts == 0:
        return [Measured(name, None, note="left out here") for name in ("start.first", "start.later")]
    with tempfile.TemporaryDirectory() as folder:
        first, *later = (_seconds(f"0,1,{10 + k}", folder) for k in range(1 + effort.starts))
    command = " ".join(("bodycheck", *_COMMAND[3:], "0,1,10"))
    return [
        Measured("start.first", first, note=command),
        Measured.of("start.later", Spread.of(np.array(later)), command),
    ]


def _seconds(at: str, kernels: str) -> float:
    begin = time.perf_counter()
    subprocess.run(
        (*_COMMAND, at),
        cwd=_TREE,
        env={**os.environ, "BODYCHECK_CACHE_DIR": kernels},
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return time.perf_counter() - begin
