"""A body and its loads, given by a few numbers instead of a scenario file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_members

_TENSORS = (3, 9)


@dataclass(frozen=True)
class GivenMotion:
    """A body whose motion starts at the first row of a recording.

    inertia_kg_m2: principal moments (3,) in body axes, or a tensor (9,), row by row. torque_body_n_m:
    constant, in body axes (3,). gravity_m_s2: uniform, in world axes (3,).
    """

    inertia_kg_m2: Sequence[float]
    mass_kg: float = 1.0
    torque_body_n_m: Sequence[float] | None = None
    gravity_m_s2: Sequence[float] | None = None

    def scenario(self, duration_s: float, samples: int) -> Scenario:
        """Return the scenario, at rest; raises InputError with one line per error if no body is such."""
        numbers = [float(one) for one in self.inertia_kg_m2]
        faults = []
        if len(numbers) not in _TENSORS:
            faults.append(f"--inertia-kg-m2: must be 3 principal moments or 9 numbers, not {len(numbers)}")
        for option, vector in (("torque-body-n-m", self.torque_body_n_m), ("gravity", self.gravity_m_s2)):
            if vector is not None and len(vector) != 3:
                faults.append(f"--{option}: must be three components, not {len(vector)}")
        if faults:
            raise InputError("\n".join(faults))
        tensor = numbers if len(numbers) == 3 else [numbers[row : row + 3] for row in (0, 3, 6)]
        lines = [
            'name = "given body"',
            f"duration_s = {duration_s!r}",
            f"samples = {samples}",
            "[body]",
            f"mass_kg = {float(self.mass_kg)!r}",
            f"inertia_kg_m2 = {tensor}",
        ]
        if self.torque_body_n_m is not None:
            torque = [float(one) for one in self.torque_body_n_m]
            lines += ["[[forcing]]", 'kind = "torque"', 'axes = "body"', f"value_n_m = {torque}"]
        if self.gravity_m_s2 is not None:
            acceleration = [float(one) for one in self.gravity_m_s2]
            lines += ["[[forcing]]", 'kind = "gravity"', f"acceleration_m_s2 = {acceleration}"]
        (scenario,) = parse_members("\n".join(lines), where="the options", folder=Path()).values()
        return scenario
