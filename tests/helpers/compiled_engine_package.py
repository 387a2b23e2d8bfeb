"""An engine package with a C library, a data file and a second module, created in a folder."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from textwrap import dedent

import pytest

needs_a_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")

ADAPTER = dedent("""
    import ctypes
    from dataclasses import replace
    from pathlib import Path

    from bodycheck.adapters.contract import Method
    from shaky import second

    _HERE = Path(__file__).parent
    _LIBRARY = ctypes.CDLL(str(_HERE / "libshaky.so"))
    _LIBRARY.factor.restype = ctypes.c_double


    class Shaky:
        name = "shaky"
        version = "1.0"
        methods = {"m1": Method("m1", "m1", 1, 1, "every stage", "nothing", "made up")}

        def unsupported(self, scene, method):
            return None

        def build(self, scene, method, dt_s):
            from bodycheck.adapters.reference import FixedStep
            from bodycheck.reference_impl.integrators import INTEGRATORS

            return Scaled(FixedStep(scene, INTEGRATORS["m1"], dt_s))


    class Scaled:
        stepping = "native"

        def __init__(self, sound):
            self._sound, self._scale = sound, 1.0
            self.read_back, self.reset, self.apply = sound.read_back, sound.reset, sound.apply
            self.close = sound.close

        def advance(self, steps):
            self._scale = _LIBRARY.factor() * second.FACTOR
            self._sound.advance(steps)

        def read(self):
            found = self._sound.read()
            return replace(found, omega_body=found.omega_body * self._scale)
""")


def write_shaky(site: Path) -> None:
    """Install the package, version 1.0, into a folder."""
    package, facts = site / "shaky", site / "shaky-1.0.dist-info"
    package.mkdir(parents=True)
    facts.mkdir()
    (package / "__init__.py").write_text(ADAPTER)
    (package / "second.py").write_text("FACTOR = 1.0\n")
    (package / "table.dat").write_text("1 2 3\n")
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: shaky\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[bodycheck.adapters]\nshaky = shaky:Shaky\n")
    build_library(site, 1.0)


def build_library(site: Path, factor: float) -> None:
    """Compile the library of the package and replace the existing one."""
    source, made = site / "shaky.c", site / "made.so"
    source.write_text(f"double factor(void) {{ return {factor!r}; }}\n")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(made), str(source)], check=True)
    made.replace(site / "shaky" / "libshaky.so")
