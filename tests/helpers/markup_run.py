"""A small run with everything that a report can show, under names that look like markup."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import registered
from bodycheck.reference_impl.scene import Scene
from tests.helpers.scenario_texts import tumbling

if TYPE_CHECKING:
    from bodycheck.reports.run_files.run_tables import Run

METHODS = ("exact", "taylor", "euler", "lie-euler", "rk4", "m1", "m2", "m3", "cf4")
"""Methods of the reference: each kind of control, several orders, and one wrong in the orientation only."""

HOSTILE = "<script>alert(1)</script>"
_FAMILY, _, _VALUE = HOSTILE.partition("/")  # only a member of a family has a slash in its name
FREE = 'summary = "</script><!-- %{x} $x$ \\u2028 <b>bold</b> & {{ 7 * 7 }}"' + tumbling(
    _FAMILY, steps_s=[0.05, 0.02, 0.01, 0.005]
)
_SWEEP = f"""
[[sweep]]
key = "source"
values = ["{_VALUE}"]
"""
FORCED = (
    FREE.replace(_FAMILY, "forced").replace(
        "[1.0, 2.0, 2.5]", "[[1.0, 0.2, 0], [0.2, 2.0, 0.1], [0, 0.1, 2.5]]"
    )
    + """
[[forcing]]
kind = "torque"
axes = "world"
value_n_m = [0.1, 0.2, -0.1]
"""
)


class Tampered:
    """A simulation of the reference that fails in the way that its method is named after."""

    stepping = "python"

    def __init__(self, inner: Simulation, how: str) -> None:
        self._inner, self._how, self._steps = inner, how, 0
        self.reset, self.apply, self.close = inner.reset, inner.apply, inner.close

    def read_back(self) -> ReadBack:
        """Report another mass, if that is the fault."""
        held = self._inner.read_back()
        return replace(held, mass=3.0) if self._how == "<i>invalid</i>" else held

    def advance(self, steps: int) -> None:
        """Raise, if that is the fault."""
        if self._how == "<b>failed</b>":
            raise RuntimeError(f"{HOSTILE} <!-- & 'quoted'")
        self._steps += steps
        self._inner.advance(steps)

    def read(self) -> Reading:
        """Return NaN as the position after five steps, if that is the fault."""
        reading = self._inner.read()
        if self._how == "unstable" and self._steps > 5:
            return replace(reading, position=np.full(3, np.nan))
        return reading


class MarkupEngine:
    """An engine with a hostile name, each of whose methods fails in its own way."""

    name = HOSTILE
    version = "1 < 2"

    def __init__(self) -> None:
        known = Reference().methods["rk4"]
        self.methods: Mapping[str, Method] = {
            name: replace(known, name=name, formula="a < b & c", changed_defaults=("<u>none</u>",))
            for name in ("<b>failed</b>", "<i>invalid</i>", "unstable", "unsupported", "sound")
        }

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse the method `unsupported`."""
        del scene
        return "no <em>such</em> thing" if method == "unsupported" else None

    def build(self, scene: Scene, method: str, dt_s: float) -> Any:
        """Return the reference's rk4 with the fault of the method."""
        return Tampered(Reference().build(scene, "rk4", dt_s), method)


def markup_run(folder: Path) -> Run:
    """Return a run of the reference and the odd engine on a free and a forced scenario, written to folder."""
    # imported late: the engine's workers import this module, and need no pandas
    from bodycheck.runs.runner import run as measure

    files = [folder / name for name in ("free.toml", "forced.toml")]
    for file, text in zip(files, (FREE + _SWEEP, FORCED), strict=True):
        file.write_text(text, encoding="utf-8")
    with registered(MarkupEngine()):
        measured = measure(files, engines=[*(f"reference:{name}" for name in METHODS), MarkupEngine.name])
    absent = {"absent": {"unavailable": "absent cannot be imported: <tt>no module</tt>"}}
    known = measured.manifest
    asked = {"request": {**known["request"], "engines": ["reference", MarkupEngine.name]}}  # none by name
    return replace(measured, manifest={**known, **asked, "engines": absent | known["engines"]})
