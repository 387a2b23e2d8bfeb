"""Measure ensembles: cost and memory per size, truths, MuJoCo's overhead, error bars.

Run as `python tools/ensemble_trials.py [PART ...]` in the activated environment. Each part prints its
figures: kernels, scaling, mujoco, quantiles [default: all].
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
from trials import command

from bodycheck.adapters.batches import Batch, record_batch
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.reference import Reference
from bodycheck.ensembles.ensemble_cases import measured, truth_of
from bodycheck.reference_impl.truth.free_batch import free_truths
from bodycheck.reports.summary.quantiles import SHARES, QuantileSketch
from bodycheck.scenarios.ensemble import Ensemble, default_distribution
from bodycheck.scenarios.library import load_scenario
from tests.helpers.quantile_agreement import agree

_SCENARIO, _DT_S, _STEPS = "intermediate-axis", 1e-2, 1000
_TRIALS, _BODIES = 100, 100_000


def _ensemble(seed: int) -> Ensemble:
    scenario = load_scenario(_SCENARIO)
    return Ensemble(scenario, default_distribution(scenario), seed, 5)


def _cpu_s(work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


def kernels() -> None:
    """Print the CPU time per body of the draw, the truth with floors, the steps, and the measures."""
    ensemble, n = _ensemble(1), 20_000
    template = ensemble.template
    for first in (0, n):  # the first pass compiles
        bodies = ensemble.bodies(first, first + n)
        draw = _cpu_s(lambda first=first: ensemble.bodies(first, first + n))
        given = bodies.inertia, bodies.quaternion, bodies.omega_body, template.sample_times
        truth = _cpu_s(lambda given=given: free_truths(*given))
    print(f"draw: {draw / n * 1e6:.2f} us per body")
    print(f"truth with floors at 5 samples: {truth / n * 1e6:.1f} us per body")
    for method in ("m1", "rk4", "dop853"):
        batch = Batch(template, bodies, method, Setting(dt_s=_DT_S))
        record_batch(Reference(), batch[:100])
        step = _cpu_s(lambda batch=batch: record_batch(Reference(), batch))
        print(f"{method}: {step / n / _STEPS * 1e9:.2f} ns per step")
    answer, known = record_batch(Reference(), batch), truth_of(template, bodies, free=True)
    measure = _cpu_s(lambda: measured(template, bodies, known, answer))
    print(f"measures: {measure / n * 1e6:.1f} us per body")


def _run(engine: str, n: int) -> tuple[float, float, float]:
    """Return CPU seconds, seconds and peak memory in MB of one command, without its workers' memory."""
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "bodycheck", "ensemble", _SCENARIO, "--n", str(n), "--engine", engine]
        begin = time.perf_counter()
        process = subprocess.Popen([*words, "--out", f"{folder}/out", "--quiet"], stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = status
        if status:
            sys.exit(f"{' '.join(words)}: status {status}")
        return used.ru_utime + used.ru_stime, time.perf_counter() - begin, used.ru_maxrss / 1024


def scaling() -> None:
    """Print the cost of ensembles of 1e3 to 1e6 bodies."""
    for engine in ("reference:rk4", "reference:m1"):
        for n in (1000, 10_000, 100_000, 1_000_000):
            cpu_s, elapsed_s, peak_mb = _run(engine, n)
            print(f"{engine}, n = {n}: {cpu_s:.1f} CPU s, {elapsed_s:.1f} s, {peak_mb:.0f} MB")


def mujoco() -> None:
    """Print the CPU time of a batch relative to that of its rollout alone, without building models."""
    from bodycheck.adapters.mujoco import MuJoCo, rollouts

    ensemble, n = _ensemble(1), 512
    batch = Batch(ensemble.template, ensemble.bodies(0, n), "rk4", Setting(dt_s=_DT_S))
    engine, parts = MuJoCo(), {"build": 0.0, "rollout": 0.0}
    build, rolled = engine.build, rollouts.rollout.rollout

    def timed(name: str, call: Callable[..., object]) -> Callable[..., object]:
        def measured_call(*given: object, **named: object) -> object:
            begin = time.process_time()
            try:
                return call(*given, **named)
            finally:
                parts[name] += time.process_time() - begin

        return measured_call

    engine.build = timed("build", build)  # type: ignore[method-assign]
    rollouts.rollout.rollout = timed("rollout", rolled)
    try:
        answer: list[object] = []
        whole = _cpu_s(lambda: answer.append(record_batch(engine, batch)))
    finally:
        rollouts.rollout.rollout = rolled
    truth = truth_of(ensemble.template, batch.bodies, free=True)
    rest = _cpu_s(lambda: truth_of(ensemble.template, batch.bodies, free=True))
    rest += _cpu_s(lambda: measured(ensemble.template, batch.bodies, truth, answer[0]))  # type: ignore[arg-type]
    ratio = (whole - parts["build"] + rest) / parts["rollout"]
    print(f"build: {parts['build'] / n * 1e6:.0f} us per body")
    print(f"bare rollout: {parts['rollout'] / n / _STEPS * 1e9:.0f} ns per step")
    print(f"with read-back, reading, truth and measures: {ratio:.3f} x the bare rollout")


def quantiles() -> None:
    """Print in how many of 100 trials each quantile of two seeds agrees within the 95 % error bars."""
    agreed = np.zeros(len(SHARES), dtype=int)
    for trial in range(_TRIALS):
        one, other = (_sketch(2 * trial + seed) for seed in (1, 2))
        agreed += [agree(one.quantile(share), other.quantile(share)) for share in SHARES]
    for share, count in zip(SHARES, agreed, strict=True):
        print(f"quantile {share:g} at n = {_BODIES}: {count} of {_TRIALS} agree")


def _sketch(seed: int) -> QuantileSketch:
    """Return the sketch of a quantity that needs no truth: the distance of each body from the separatrix."""
    sketch = QuantileSketch()
    sketch.add(_ensemble(seed).bodies(0, _BODIES).separatrix_distance)
    return sketch


_PARTS = {part.__name__: part for part in (kernels, scaling, mujoco, quantiles)}


def main(*parts: str) -> None:
    """Run the requested parts, and print the load of the machine."""
    for name in parts or _PARTS:
        print(f"{name} (load {os.getloadavg()[0]:.1f})")
        _PARTS[name]()
    print(f"peak memory of this process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    command(main)
