"""The probes of one method: two short scenes, each at several steps, and their findings.

The numbers that a method holds after each step show whether it computes in the precision that it states: an
exact motion has smooth samples, whose eighth differences, of order (omega h)^8, are far below round-off.
What is left is the round-off of single steps, also where only one stage of a step is rounded to float32.
A method may alternate between maps, as a splitting and its adjoint, so that only every second sample, or
every third, lies on a smooth motion: the smallest round-off of any such period counts. What falls with the
step as no round-off does is another irregularity of the map, such as substeps of its own: the probe cannot
tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Engine, Method, Precision, read_back_mismatch
from bodycheck.adapters.execution import Case
from bodycheck.adapters.stable_step import invalid_state
from bodycheck.examine.probes.finding import Finding, Sampled
from bodycheck.examine.probes.readings import reading_findings
from bodycheck.examine.probes.responses import gravity_finding, response_findings
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.case import RunCase, reproducing_command
from bodycheck.scenarios.library import PROBES, load_scenario
from bodycheck.scenarios.model import Scenario

_DIFFERENCES = 8
_DIFFERENCE_NORM = float(np.sqrt(12870.0))  # of an eighth difference of independent errors: C(16, 8)
_EPS, _SINGLE_EPS = float(np.finfo(np.float64).eps), float(np.finfo(np.float32).eps)
_MAX_DOUBLE = 16.0 * _EPS  # healthy methods stay below one, a float32 stage is above 70
_MIN_SINGLE = 1e-3 * _SINGLE_EPS
_PERIODS = range(1, 7)  # of maps that alternate: longer ones leave too few samples
_ALTERNATES = 10.0  # ratio of the round-off of every sample to that of the samples of a period
_FALLS = 1.5  # power of the step; round-off of the state has 0, that of one stage 1, that of a map 2 or more


def precision_finding(path: Trajectory, stated: Precision, coarser: Trajectory | None = None) -> Finding:
    """Return the largest round-off of one step, relative, against the stated precision.

    path: of a free motion, one sample after each step; the steps are not dyadic, so that double precision
    leaves no number that fits into float32. coarser: the same at a longer step [default: not compared].
    """
    found, period = min((_round_off_of(path, period), period) for period in _PERIODS)
    if _ALTERNATES * found > _round_off_of(path, 1):
        period = 1  # no period makes the motion smooth
    single = is_single(path)
    message = ""
    if stated == "float64":
        if single:
            message = "every number fits into float32: the state is not held in float64"
        elif found > _MAX_DOUBLE:
            if coarser is not None and _falls(path, coarser, period):
                reason = "the motion is not smooth from step to step, so that round-off cannot be measured"
                return Finding("precision", message=reason)
            message = f"steps are rounded at {found:.1e} of the state: not all of the arithmetic is float64"
        deviation = 1.0 if single else found
        return Finding("precision", found, 0.0, deviation, _MAX_DOUBLE, message)
    wrong = not single and found < _MIN_SINGLE
    if wrong:
        message = f"steps are rounded at {found:.1e} of the state: it is held in float64"
    return Finding("precision", found, _SINGLE_EPS, float(wrong), 0.0, message)


def _falls(path: Trajectory, coarser: Trajectory, period: int) -> bool:
    """Whether what looks like round-off falls with the step faster than any round-off."""
    ratio = float((coarser.t_s[1] - coarser.t_s[0]) / (path.t_s[1] - path.t_s[0]))
    return _round_off_of(coarser, period) > ratio**_FALLS * _round_off_of(path, period)


def is_single(path: Trajectory) -> bool:
    """Whether all velocities and omegas after a step fit into float32."""
    omega = path.omega_world_rad_s if path.omega_body_rad_s is None else path.omega_body_rad_s
    readings = (values[1:] for values in (path.velocity_m_s, omega) if values is not None)
    return all(bool(np.all(values == values.astype(np.float32))) for values in readings)


def arithmetic_eps(path: Trajectory, stated: Precision) -> float:
    """Return the eps of single precision if a method states it or its motion shows it, else of double."""
    return _SINGLE_EPS if stated != "float64" or is_single(path) else _EPS


def _states(path: Trajectory) -> list[Array]:
    quaternion = None if path.quaternion is None else _continuous(path.quaternion)
    readings = (quaternion, path.rotation, path.omega_body_rad_s, path.omega_world_rad_s)
    extra = [values.reshape(len(values), -1) for values in readings if values is not None]
    return [path.position_m, path.velocity_m_s, *extra]


def _continuous(quaternion: Array) -> Array:
    """Return the quaternions (n, 4) of the same attitudes without jumps from q to -q."""
    jumps = np.sum(quaternion[1:] * quaternion[:-1], axis=-1) < 0.0
    signs = np.cumprod(np.where(np.concatenate([[False], jumps]), -1.0, 1.0))
    return quaternion * signs[:, np.newaxis]


def _round_off_of(path: Trajectory, period: int) -> float:
    """Return the largest round-off of any quantity, from samples a period of steps apart."""
    return max(_round_off(values[::period]) for values in _states(path))


def _round_off(values: Array) -> float:
    """Return the median |eighth difference| of values (n, k), over its norm and the largest value."""
    size = float(np.max(np.abs(values)))
    if size == 0.0 or len(values) <= _DIFFERENCES:
        return 0.0
    differences = np.median(np.abs(np.diff(values, _DIFFERENCES, axis=0)), axis=0)
    return float(np.max(differences)) / (_DIFFERENCE_NORM * size)


@dataclass(frozen=True, eq=False)
class Probe:
    """A short scene and its steps, coarsest first; name: of its built-in scenario."""

    name: str
    scene: Scene
    steps_s: tuple[float, ...]


@cache
def built_in_probes() -> tuple[Probe, Probe]:
    """Return the probe under loads, which starts from rest, and the free probe."""
    loaded, free = (load_scenario(name) for name in PROBES)
    return _probe_of(loaded), _probe_of(free)


def _probe_of(scenario: Scenario) -> Probe:
    return Probe(scenario.name, scenario.scene, tuple(sorted(scenario.steps, reverse=True)))


@dataclass(frozen=True, eq=False)
class _Probed:
    """The motions of a probe at all its steps, coarsest first, or the reason why there are none.

    mismatch: which of the engine's parameters differed from the given ones before the first step.
    """

    probe: Probe
    method: Method
    motions: tuple[Sampled, ...] = ()
    reason: str = ""
    mismatch: str | None = None

    @property
    def timed_out(self) -> bool:
        """Whether the engine did not answer in time."""
        return self.reason.startswith("timeout")

    @property
    def resolution(self) -> float:
        """The relative round-off of the finest motion: one per step, all with the same sign.

        A method that is controlled by a tolerance may use it in full in each step.
        """
        if not self.motions:
            return 0.0
        path = self.motions[-1].trajectory
        eps = arithmetic_eps(path, self.method.precision)
        return (len(path.t_s) - 1) * max(eps, self.method.finest_tolerance or 0.0)


def probe_rows(engine: Engine, method: Method, ask: RunCase) -> list[dict[str, Any]]:
    """Return the rows of probes.csv of one method without run_id; failures are rows too."""
    first, second = built_in_probes()
    rows: list[dict[str, Any]] = []
    loaded = motions_of(first, engine, method, ask)
    # do not wait a second time for an engine that timed out
    free = replace(loaded, probe=second) if loaded.timed_out else motions_of(second, engine, method, ask)
    for probed, findings in (
        (loaded, _loaded_findings(loaded)),
        (free, _free_findings(free, loaded)),
    ):
        finest = method.setting(probed.probe.steps_s[-1])
        shared = {
            "engine": engine.name,
            "engine_version": engine.version,
            "method": method.name,
            "dt_s": finest.dt_s,
            "reproduce": reproducing_command(probed.probe.name, engine, method, finest),
        }
        rows += [{**shared, **vars(finding), "verdict": finding.verdict} for finding in findings]
    return rows


def motions_of(probe: Probe, engine: Engine, method: Method, ask: RunCase) -> _Probed:
    """Run one probe at each of its steps, sampled after every step, until one fails."""
    motions = []
    mismatch = None
    for dt_s in probe.steps_s:
        scene = replace(probe.scene, samples=round(probe.scene.duration_s / dt_s) + 1)
        setting = method.setting(dt_s)
        answer = ask(engine, Case(scene, method.name, setting))
        if answer.trajectory is None or answer.read_back is None:
            return _Probed(probe, method, reason=f"{answer.outcome}: {answer.message}")
        mismatch = mismatch or read_back_mismatch(scene, setting.dt_s, answer.read_back, method.precision)
        if reason := invalid_state(answer.trajectory):
            return _Probed(probe, method, reason=f"unstable: {reason}", mismatch=mismatch)
        motions.append(Sampled(scene, answer.trajectory))
    return _Probed(probe, method, tuple(motions), "", mismatch)


def _loaded_findings(loaded: _Probed) -> Iterator[Finding]:
    yield from _read_back("read_back", loaded)
    if loaded.motions:
        with np.errstate(all="ignore"):  # finite states may still overflow in the formulas
            yield from response_findings(loaded.motions, loaded.resolution)
    else:
        yield Finding("responses", message=loaded.reason)


def _free_findings(free: _Probed, loaded: _Probed) -> Iterator[Finding]:
    yield from _read_back("free_read_back", free)
    if not free.motions:
        yield Finding("readings", message=free.reason)
        return
    with np.errstate(all="ignore"):
        if not loaded.motions:
            yield gravity_finding(free.motions, free.resolution)
        yield from reading_findings(free.motions, free.resolution)
    if free.method.control == "dt":
        coarser, _, finest = (motion.trajectory for motion in free.motions[-3:])
        yield precision_finding(finest, free.method.precision, coarser)


def _read_back(check: str, probed: _Probed) -> Iterator[Finding]:
    """Yield a finding with deviation 1 where the engine's parameters differ from those it was given."""
    if probed.mismatch is not None:
        yield Finding(check, 1.0, 0.0, 1.0, 0.0, probed.mismatch)
