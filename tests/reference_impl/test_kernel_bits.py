"""The bits of a result do not depend on whether its kernels were compiled or loaded."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import hashlib
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.scenarios.library import load_scenario

for name in ("powered-flight", "intermediate-axis"):
    scene = load_scenario(name).scene
    for method in {methods!r}:
        case = Case(scene, method, Setting(dt_s=scene.sample_interval_s / 10))
        motion = record(Reference(), case).trajectory
        bits = motion.omega_body.tobytes() + motion.attitude.tobytes() + motion.position_m.tobytes()
        print(name, method, hashlib.sha256(bits).hexdigest())
"""


def bits(folder: Path, *methods: str) -> str:
    """Return the hashes of motions, from a process with this cache of kernels."""
    environment = {**os.environ, "BODYCHECK_CACHE_DIR": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(methods=methods)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


@pytest.mark.nightly
@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="nothing is compiled")
def test_compiling_process_and_later_ones_give_the_same_bits(tmp_path: Path) -> None:
    """M2 and M3 share a kernel, of which each has a copy that LLVM optimises separately."""
    assert bits(tmp_path, "m2", "m3") == bits(tmp_path, "m2", "m3")


@pytest.mark.nightly
@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="nothing is compiled")
def test_every_method_gives_the_same_bits_in_the_compiling_process_and_later_ones(tmp_path: Path) -> None:
    """All fixed-step methods, with an empty cache and with a full one."""
    from bodycheck.adapters.reference import Reference

    names = [name for name, method in Reference().methods.items() if method.control == "dt"]
    assert bits(tmp_path, *names) == bits(tmp_path, *names)
