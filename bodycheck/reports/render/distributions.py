"""Draw how the measures of an ensemble are distributed: the share of bodies above each error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement.rotation_measures import ROTATION_MEASURES
from bodycheck.reports.render.figures import figure_bytes, rendering
from bodycheck.reports.summary.quantiles import QuantileSketch

_LABELS = {
    "orientation_error_rad": "orientation error (rad)",
    "omega_error": "relative error of omega",
    "rotational_energy_drift": "relative drift of the energy",
    "angular_momentum_drift": "relative drift of the angular momentum",
}
_SIZE_IN = (7.2, 5.6)
_SMALLEST = 1e-17  # an error of 0 is drawn here


def distributions_svg(methods: Sequence[tuple[str, Mapping[str, QuantileSketch]]]) -> bytes:
    """Return one panel per measure; methods: (label, sketches by measure)."""
    with rendering():
        from matplotlib.figure import Figure

        page = Figure(figsize=_SIZE_IN, layout="constrained")
        panels = page.subplots(2, 2)
        for axes, measure in zip(panels.flat, ROTATION_MEASURES, strict=True):
            for label, sketches in methods:
                if sketches[measure].total:
                    axes.step(*_share_above(sketches[measure]), where="post", label=label)
            axes.set(xscale="log", yscale="log", xlabel=_LABELS[measure], ylabel="share of bodies above")
        panels.flat[0].legend(loc="lower left")
        return figure_bytes(page, ".svg")


def _share_above(sketch: QuantileSketch) -> tuple[Array, Array]:
    """Return finite errors (k,), ascending, and the share of all bodies with at least that error (k,)."""
    low, _ = sketch.edges
    above = 1.0 - (np.cumsum(sketch.counts) - sketch.counts) / sketch.total
    finite = np.isfinite(low)
    return np.maximum(low[finite], _SMALLEST), above[finite]
