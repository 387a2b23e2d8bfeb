"""How finely a recording states each quantity, and how far that leaves its states open."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import names, number
from bodycheck.reference_impl.arrays import Array

UNITS = {"position": "m", "velocity": "m/s", "attitude": "rad", "omega": "rad/s"}
QUANTITIES = tuple(UNITS)
_SINGLE = float(np.finfo(np.float32).eps)
_PER_ARRAY = {
    "position_m": ("position", 1.0),
    "velocity_m_s": ("velocity", 1.0),
    "quaternion": ("attitude", 2.0),  # an angle is twice the change of a quaternion
    "rotation": ("attitude", 1.0),
    "omega_body_rad_s": ("omega", 1.0),
    "omega_world_rad_s": ("omega", 1.0),
}
"""Array -> its quantity, and how far this moves with a number of the array."""


@dataclass(frozen=True)
class Resolution:
    """The distance between neighbouring values that a recording can state, of each quantity in SI units.

    attitude in rad, stamp in s. A stated number is off by at most half of this, as it is rounded to it.
    noise: the quantities whose numbers are off by noise with the deviation of such rounding instead.
    """

    position: float = 0.0
    velocity: float = 0.0
    attitude: float = 0.0
    omega: float = 0.0
    stamp: float = 0.0
    noise: frozenset[str] = frozenset()

    @property
    def is_stated(self) -> bool:
        """Whether the numbers are those of a recording, whose resolution is known."""
        return self.attitude > 0.0 or self.omega > 0.0

    @classmethod
    def of(cls, spacings: Mapping[str, Array]) -> Resolution:
        """Return the resolution of the arrays of a recording; spacings: array -> those of its numbers."""
        found: dict[str, Any] = {"stamp": float(np.max(spacings.get("t_s", np.zeros(1))))}
        for name, (quantity, factor) in _PER_ARRAY.items():
            if name in spacings:
                found[quantity] = max(found.get(quantity, 0.0), factor * float(np.max(spacings[name])))
        return cls(**found)

    def with_given(self, text: str) -> Resolution:
        """Return the resolution with what an option states: "1e-3", or "omega=1e-3, attitude=1e-5".

        Raises InputError for an unknown quantity, and for what is no positive number.
        """
        changes: dict[str, Any] = {}
        for part in text.split(","):
            name, equals, value = (one.strip() for one in part.rpartition("="))
            if equals and name not in QUANTITIES:
                raise InputError(f"--resolution {text}: {name!r} must be one of {', '.join(QUANTITIES)}")
            try:
                size = float(value)
            except ValueError:
                size = math.nan
            if not 0.0 < size < math.inf:
                raise InputError(f"--resolution {text}: {value!r} is not a positive number")
            changes |= {name: size} if equals else dict.fromkeys(QUANTITIES, size)
        return replace(self, **changes)

    def text(self, known: frozenset[str]) -> str:
        """Return the coarser resolution of attitude and omega in words; other quantities may be round."""
        if self.noise:
            parts = [f"{number(getattr(self, one) / math.sqrt(12.0), 2)} {UNITS[one]} in {one}"
                     for one in QUANTITIES if one in self.noise]  # fmt: skip
            return f"the noise of the file, {names(parts)}"
        quantity = max(known & {"attitude", "omega"}, key=lambda name: getattr(self, name))
        size = getattr(self, quantity) / (2.0 if quantity == "attitude" else 1.0)
        decimals = -math.log10(size) if size > 0.0 else math.inf
        if abs(decimals - round(decimals)) < 1e-6 and decimals < 15.5:
            return f"the {round(decimals)} decimals of the file"
        finest = f"{number(getattr(self, quantity), 2)} {UNITS[quantity]}"
        return f"the resolution of the file, {finest} in {quantity}"


NOT_RECORDED = Resolution()
"""Of a trajectory that has all digits of the program."""
