"""A package index in a folder: releases of a toy engine, and the packages that its environment needs."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from textwrap import dedent

import numpy as np

TOY = dedent("""
    from bodycheck.adapters.contract import Method


    class Toy:
        name = "toy"
        version = "{announced}"
        methods = {{"m": Method("m", "{method}", {order}, 1, "every stage", "nothing", "made up")}}

        def unsupported(self, scene, method):
            return None

        def build(self, scene, method, dt_s):
            # late: numba is not needed to announce an engine
            from bodycheck.adapters.reference import FixedStep
            from bodycheck.reference_impl.integrators import INTEGRATORS

            return FixedStep(scene, INTEGRATORS["{method}"], dt_s)
""")
_ORDERS = {"m1": 1, "rk4": 4}
# the toy requires a bodycheck that no registry has, since its environment must not install one
_NEEDS = {"toy_engine": "Requires-Dist: numpy\nRequires-Dist: bodycheck>=99\n"}


def write_wheel(folder: Path, name: str, release: str, files: Mapping[str, str], points: str = "") -> Path:
    """Write a wheel of a pure Python package without building it."""
    facts, needs = f"{name}-{release}.dist-info", _NEEDS.get(name, "")
    within = {
        **files,
        f"{facts}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {release}\n{needs}",
        f"{facts}/WHEEL": "Wheel-Version: 1.0\nGenerator: hand\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{facts}/entry_points.txt": points,
    }
    path = folder / f"{name}-{release}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for place, text in within.items():
            wheel.writestr(place, text)
        wheel.writestr(f"{facts}/RECORD", "".join(f"{place},,\n" for place in (*within, f"{facts}/RECORD")))
    return path


def write_toy(folder: Path, release: str, method: str, *, announced: str | None = None) -> Path:
    """Write a release of the toy engine, whose only method is m1 or rk4 of the reference."""
    code = TOY.format(announced=announced or release, method=method, order=_ORDERS[method])
    points = "[bodycheck.adapters]\ntoy = toy_engine:Toy\n"
    return write_wheel(folder, "toy_engine", release, {"toy_engine.py": code}, points)


def write_needed(folder: Path) -> None:
    """Write wheels for the imports of the worker that point to the packages here: tests have no network."""
    here = str(Path(np.__file__).parents[1])
    for name in ("numpy", "numba", "pydantic"):
        write_wheel(folder, name, version(name), {f"{name}-from-here.pth": f"{here}\n"})
