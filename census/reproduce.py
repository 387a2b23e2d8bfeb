"""Run the command and the driver of a finding, and compare what they print with the stated figures."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from bodycheck.adapters.engine_names import Pin, pin_of
from bodycheck.adapters.versions.environments import NODE_PACKAGES, needed_environment, program_in, python_of
from bodycheck.adapters.versions.uv import uv_program
from census.finding import DRIVERS, INPUTS, WITHIN, Figure, Finding

_TABLE = "results.csv"
_ERRORS = (0, 1)
"""Exit statuses of commands that have printed their answer: 1 is a finding of theirs."""


@dataclass(frozen=True)
class Compared:
    """A figure: what is stated, what was found, None if nothing was, and whether they agree."""

    place: str
    stated: Figure
    found: object

    @property
    def agrees(self) -> bool:
        """Whether a number is within WITHIN of the stated one, or a text contains it."""
        if isinstance(self.stated, str):
            return isinstance(self.found, str) and self.stated in self.found
        if isinstance(self.found, bool) or not isinstance(self.found, int | float):
            return False
        return abs(self.found - self.stated) <= WITHIN * abs(self.stated)


def reproduce(finding: Finding) -> list[Compared]:
    """Run the command and the driver of a finding, and return each figure that it states."""
    ways = ((finding.command, _by_bodycheck), (finding.driver, _by_driver))
    return [one for stated, way in ways if stated for one in way(finding)]


def _by_bodycheck(finding: Finding) -> Iterator[Compared]:
    words = shlex.split(finding.command)[1:]
    with tempfile.TemporaryDirectory() as folder:
        for name in finding.inputs:
            shutil.copy(INPUTS / name, folder)
        out = ["--out", "run"] if words[0] == "run" else []
        done = _printed([sys.executable, "-m", "bodycheck", *words, *out, "--json"], folder, {})
        try:
            answer = json.loads(done)
        except ValueError:
            answer = {}
        for place, stated in finding.figures.items():
            if place.startswith(f"{_TABLE}/"):
                found: object = _largest(Path(folder) / "run" / _TABLE, place.partition("/")[2])
            else:
                found = looked_up(answer, place)
            yield Compared(place, stated, found)


def _by_driver(finding: Finding) -> Iterator[Compared]:
    module, experiment = finding.driver.split()
    pin = None if finding.packages else pin_of(finding.environment) or needed_environment(finding.environment)
    variables: Mapping[str, str] = {}
    if finding.packages:
        run = [uv_program(), "run", "--quiet", "--no-project", "--isolated", "--no-build"]
        run += ["--python", finding.python or sys.executable]
        run += [word for one in finding.packages for word in ("--with", one)]
        command = [*run, "python", str(DRIVERS), module, experiment]
    elif module.endswith(".mjs"):
        assert isinstance(pin, Pin)
        program = program_in(pin)
        assert program is not None
        variables = {NODE_PACKAGES: program.environment[NODE_PACKAGES]}
        command = ["node", str(DRIVERS / module), experiment]
    else:
        python = sys.executable if pin is None else str(python_of(pin))
        command = [python, str(DRIVERS), module, experiment]
    with tempfile.TemporaryDirectory() as folder:
        lines = [line for line in _printed(command, folder, variables).splitlines() if "figures" in line]
    found = json.loads(lines[-1].partition("figures ")[2]) if lines else []
    for place, stated in enumerate(finding.driver_figures):
        yield Compared(f"{finding.driver} [{place}]", stated, found[place] if place < len(found) else None)


def _printed(command: list[str], folder: str, variables: Mapping[str, str]) -> str:
    done = subprocess.run(
        command, cwd=folder, env=os.environ | dict(variables), capture_output=True, text=True, check=False
    )
    if done.returncode not in _ERRORS or not done.stdout:
        print(done.stderr[-2000:], file=sys.stderr)
    return done.stdout


def looked_up(answer: Any, place: str) -> Any:
    """Return what stands at a place such as `links/0/held/pybullet:default/causes`; None if nothing does.

    In a list, `key=value` is the first entry with this value. A list at the place is its entries as one text.
    """
    for part in place.split("/"):
        if isinstance(answer, list):
            key, _, value = part.partition("=")
            if value:
                answer = next((one for one in answer if str(one.get(key)) == value), None)
            else:
                answer = answer[int(part)] if int(part) < len(answer) else None
        elif isinstance(answer, dict):
            answer = answer.get(part)
        else:
            return None
    return "; ".join(map(str, answer)) if isinstance(answer, list) else answer


def _largest(path: Path, column: str) -> float | None:
    if not path.is_file():
        return None
    table = pd.read_csv(path)
    return float(table[column].abs().max()) if column in table else None
