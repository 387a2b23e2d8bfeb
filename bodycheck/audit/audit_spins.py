"""Spin each link of a model file freely, and compare its motion with the truth of the body in the file."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.engine_names import pin_of
from bodycheck.adapters.execution import Case
from bodycheck.adapters.importers import ImportRequest, SpinRequest
from bodycheck.adapters.workers import protocol, received_messages
from bodycheck.adapters.workers.case_messages import case_message
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.audit.audit import Body, ImporterColumn, LinkAudit, Spin
from bodycheck.audit.audit_imports import import_request
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import log_matrix
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.scenarios.model_files.model_file import ModelFile
from bodycheck.scenarios.model_files.rewriting import excerpt

OMEGA_RAD_S = (1.1, -0.7, 2.3)
"""The angular velocity at the start in link axes: no axis of an ordinary link is near it."""
DT_S, SAMPLES, STEPS_PER_SAMPLE = 1e-3, 21, 50
METHODS = {"mujoco": "rk4", "pybullet": "multibody", "dart": "semi-implicit"}
"""Engine -> the method that spins the numbers, the one that its imported files are spun with."""


def with_spins(
    pool: EnginePool, model: ModelFile, link: LinkAudit, columns: Sequence[ImporterColumn], timeout_s: float
) -> LinkAudit:
    """Return a link with its spins in every importer that read the file."""
    if link.stated is None or not link.stated.possible:
        return link
    truth = truth_of(link.stated)
    controls: dict[str, float | None] = {}
    spins = {}
    for column in columns:
        if column.outcome == "unsupported":
            continue
        engine = column.engine
        if engine not in controls:
            controls[engine] = error_of_numbers(pool, engine, link.stated, truth, timeout_s)
        comparison = link.held.get(column.name)
        body = None if comparison is None or comparison.merged else comparison.held
        held_rad = None
        if body is not None and body.possible:
            held_rad = error_of_numbers(pool, engine, body, truth, timeout_s)
        excerpt_rad, message = _error_of_excerpt(pool, column, model, link.name, truth, timeout_s)
        spins[column.name] = Spin(controls[engine], held_rad, excerpt_rad, message)
    return replace(link, spins=spins)


def truth_of(body: Body) -> Array:
    """Return the true R (n, 3, 3) of the free spin of a body."""
    scene = _scene(body)
    return solve_truth(scene, scene.sample_times).trajectory.rotation_matrices


def _scene(body: Body) -> Scene:
    zero = np.zeros(3)
    start = State(zero, np.array([1.0, 0.0, 0.0, 0.0]), zero, np.array(OMEGA_RAD_S))
    tensor = 0.5 * (body.inertia_kg_m2 + body.inertia_kg_m2.T)
    duration_s = DT_S * STEPS_PER_SAMPLE * (SAMPLES - 1)
    return Scene(RigidBody(body.mass_kg, tensor), start, (), zero, duration_s, SAMPLES)


def error_of_numbers(
    pool: EnginePool, engine: str, body: Body, truth: Array, timeout_s: float
) -> float | None:
    """Return the error of the engine's method with a body given by numbers; None if it failed."""
    scene, pin = _scene(body), pin_of(engine)
    method = METHODS[engine if pin is None else pin.engine]
    request = {"do": "record", "case": case_message(Case(scene, method, Setting(DT_S, None)))}
    try:
        answer = received_messages.answer_of(pool.ask(engine, request, timeout_s), scene.sample_times)
    except (protocol.ProtocolError, ValueError):
        return None
    return (
        None if answer.trajectory is None else orientation_error(answer.trajectory.rotation_matrices, truth)
    )


def _error_of_excerpt(
    pool: EnginePool, column: ImporterColumn, model: ModelFile, name: str, truth: Array, timeout_s: float
) -> tuple[float | None, str]:
    """Return the error of a link imported alone, and why there is none."""
    try:
        text = excerpt(model, name)
    except InputError as error:
        return None, f"not spun alone: {error}"
    with tempfile.TemporaryDirectory(prefix="bodycheck-audit-") as folder:
        path = Path(folder) / f"excerpt{model.path.suffix or '.xml'}"
        path.write_text(text, encoding="utf-8")
        request = import_request(path, model.format, column.flags)
        rotations, why = spun(pool, column.engine, request, timeout_s)
    if rotations is None:
        return None, f"the excerpt: {why}"
    return orientation_error(rotations, truth), ""


def spun(pool: EnginePool, engine: str, request: ImportRequest, timeout_s: float) -> tuple[Array | None, str]:
    """Return R (n, 3, 3) of the free spin of a file as imported, or why there is none."""
    spin = SpinRequest(OMEGA_RAD_S, DT_S, STEPS_PER_SAMPLE, SAMPLES)
    answer = pool.ask(engine, {"do": "import", "import": asdict(request), "spin": asdict(spin)}, timeout_s)
    if answer.get("outcome") != "ok":
        return None, str(answer.get("message", ""))
    try:
        rotations = np.array(answer["rotation"], dtype=np.float64)
    except (KeyError, TypeError, ValueError) as error:
        return None, str(error)
    if rotations.shape != (SAMPLES, 3, 3):
        return None, f"rotations {rotations.shape}, not {(SAMPLES, 3, 3)}"
    return rotations, ""


def orientation_error(rotations: Array, truth: Array) -> float:
    """max |log(R*^T R)| in rad, shapes (n, 3, 3); raises ValueError for another number of samples."""
    if rotations.shape != truth.shape:
        raise ValueError(f"rotations {rotations.shape}, not {truth.shape}")
    if not np.isfinite(rotations).all():
        return float("nan")
    return float(np.max(np.linalg.norm(log_matrix(np.swapaxes(truth, 1, 2) @ rotations), axis=1)))
