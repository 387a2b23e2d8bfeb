"""The law of spellings: all model files of one body give the same motion in an engine, to round-off."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bodycheck.adapters.importers import ImportRequest, SpinRequest, importer
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.audit.audit import Audit, Body
from bodycheck.reports.audit.spelling_document import SpellingResult
from bodycheck.runs.audit_run import AuditOptions, base_engine, checked_engines, imported_audit
from bodycheck.runs.audit_spins import (
    DT_S,
    OMEGA_RAD_S,
    SAMPLES,
    STEPS_PER_SAMPLE,
    error_of_numbers,
    orientation_error,
    truth_of,
)
from bodycheck.scenarios.model_files.model_reader import read_model
from bodycheck.scenarios.model_files.rewriting import text_without_meshes
from bodycheck.scenarios.model_files.spellings import Spelling, body, spellings


@dataclass(frozen=True)
class _Spun:
    rotations: Array | None
    message: str
    causes: tuple[str, ...]


def run_spellings(engines: Sequence[str] | None, timeout_s: float) -> list[SpellingResult]:
    """Return one result per spelling and importer; raises InputError for an unknown engine."""
    truth = truth_of(Body.of(body()))
    found: list[SpellingResult] = []
    with closing(EnginePool()) as pool, tempfile.TemporaryDirectory(prefix="bodycheck-spellings-") as folder:
        for engine in checked_engines(engines):
            reads = importer(base_engine(engine))
            assert reads is not None
            control = error_of_numbers(pool, engine, Body.of(body()), truth, timeout_s)
            for kind, flags in ((kind, flags) for kind, known in reads.FLAGS.items() for flags in known):
                family = [one for one in spellings() if one.format == kind]
                spun = [_spun(pool, engine, flags, one, Path(folder), timeout_s) for one in family]
                found += _results(f"{engine}:{flags}", family, spun, truth, control)
    return found


def _results(
    name: str, family: Sequence[Spelling], spun: Sequence[_Spun], truth: Array, control: float | None
) -> Iterator[SpellingResult]:
    first = next((one.rotations for one in spun if one.rotations is not None), None)
    for spelling, one in zip(family, spun, strict=True):
        error = deviation = None
        if one.rotations is not None and first is not None:
            error, deviation = (
                orientation_error(one.rotations, truth),
                orientation_error(one.rotations, first),
            )
        yield SpellingResult(
            name, spelling.format, spelling.name, error, deviation, control, one.message, one.causes
        )


def _spun(
    pool: EnginePool, engine: str, flags: str, spelling: Spelling, folder: Path, timeout_s: float
) -> _Spun:
    path = folder / f"{spelling.name.replace(' ', '-')}.{'urdf' if spelling.format == 'urdf' else 'xml'}"
    path.write_text(spelling.text, encoding="utf-8")
    model = read_model(path)
    request = ImportRequest(str(path), model.format, flags, text_without_meshes(model))
    spin = SpinRequest(OMEGA_RAD_S, DT_S, STEPS_PER_SAMPLE, SAMPLES)
    message = {"do": "import", "import": asdict(request), "spin": asdict(spin)}
    answer = pool.ask(engine, message, timeout_s)
    audited = imported_audit(pool, model, [engine], AuditOptions(spins=False, timeout_s=timeout_s))
    causes = _causes(audited, f"{engine}:{flags}")
    if answer.get("outcome") != "ok":
        return _Spun(None, str(answer.get("message", "")), causes)
    rotations = np.array(answer["rotation"], dtype=np.float64)
    if rotations.shape != (SAMPLES, 3, 3) or not np.isfinite(rotations).all():
        return _Spun(None, "the motion is not finite", causes)
    return _Spun(rotations, "", causes)


def _causes(audited: Audit, name: str) -> tuple[str, ...]:
    comparisons = (link.held[name] for link in audited.links if name in link.held)
    return tuple(
        dict.fromkeys(cause for one in comparisons if one.state == "differs" for cause in one.causes)
    )
