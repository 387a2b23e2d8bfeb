"""Files of a measurement: results.csv (one row per figure), work-precision.csv (per point), machine.json."""

from __future__ import annotations

import json
import math
import os
import platform
from importlib.metadata import version
from io import StringIO
from pathlib import Path

import pandas as pd

from benchmarks.figures import FIGURES
from benchmarks.picture import PICTURE, work_precision_picture
from benchmarks.suite import Measurements
from benchmarks.timing import Spread
from bodycheck._util.distributions import installed
from bodycheck._util.errors import InputError
from bodycheck._util.files import write_file
from bodycheck.runs.manifest import machine

RESULTS, POINTS, MACHINE = "results.csv", "work-precision.csv", "machine.json"
_LIBRARIES = ("bodycheck", "numpy", "numba", "llvmlite", "scipy", "mujoco", "heyoka", "trimesh")

NOT_LIKE_FOR_LIKE = (
    "A kernel specialised to one rigid body beside a general engine or solver is not like for like: the "
    "engines carry joints, contacts and many bodies, the solvers any equation."
)


def write_results(measured: Measurements, folder: Path, *, command: str, quick: bool) -> None:
    """Write the four files into a folder, each atomically; create the folder if necessary.

    Raises InputError if they cannot be written.
    """
    facts = {
        "command": command,
        **machine(),
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in _LIBRARIES if installed(name)},
        "note": NOT_LIKE_FOR_LIKE,
    }
    points = points_table(measured).to_csv(index=False)
    texts = {
        RESULTS: results_table(measured, quick=quick).to_csv(index=False),
        POINTS: points,
        MACHINE: json.dumps(facts, indent=2) + "\n",
        # from the CSV text, not from memory, so that the picture can be reproduced from the file
        PICTURE: work_precision_picture(pd.read_csv(StringIO(points))),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be written: {error.strerror or error}") from None
    for name, text in texts.items():
        write_file(folder / name, text.encode())


def read_results(folder: Path) -> pd.DataFrame:
    """Return the rows of results.csv; missing numbers are NaN, missing strings empty."""
    words = dict.fromkeys(("figure", "what", "unit", "target", "verdict", "note"), "")
    return pd.read_csv(folder / RESULTS, dtype=dict.fromkeys(words, str)).fillna(words)


def read_points(folder: Path) -> pd.DataFrame:
    """Return the rows of work-precision.csv."""
    return pd.read_csv(folder / POINTS)


def results_table(measured: Measurements, *, quick: bool) -> pd.DataFrame:
    """Return one row per figure: value, quartiles, target, verdict. Quick runs have no verdicts."""
    rows = []
    for figure, found in zip(FIGURES, measured.figures, strict=True):
        assert figure.name == found.figure
        against = NOT_LIKE_FOR_LIKE if figure.name.startswith("against.") else ""
        rows.append(
            {
                "figure": figure.name,
                "what": figure.what,
                "value": _digits(found.value),
                "low": _digits(found.low),
                "high": _digits(found.high),
                "unit": figure.unit,
                "target": figure.target,
                "verdict": "" if quick else figure.verdict(found.value),
                "note": ". ".join(note for note in (found.note, against) if note),
            }
        )
    return pd.DataFrame(rows)


def points_table(measured: Measurements) -> pd.DataFrame:
    """Return one row per point. A contender that missed the error has its best setting, without times."""
    rows = []
    for point in measured.points:
        spread = None if point.seconds is None else Spread.of(point.seconds)
        rows.append(
            {
                "problem": point.problem,
                "contender": point.contender.name,
                "version": point.contender.version,
                "target_error": point.target,
                "knob": point.contender.knob,
                "setting": _digits(point.tuned.setting),
                "error": _digits(point.tuned.error),
                "time_s": spread and _digits(spread.median),
                "time_low_s": spread and _digits(spread.low),
                "time_high_s": spread and _digits(spread.high),
                "prepare_s": _digits(point.tuned.prepare_s),
            }
        )
    return pd.DataFrame(rows)


def _digits(value: float | None) -> float | None:
    """Round to four digits: no time is more precise."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.4g}")
