"""The faults of the catalogue that are wrong readings without open parameters, to be made and undone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from bodycheck.examine.diagnosis.engine_model import ReportedStates
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.fault import Misread
from bodycheck.reference_impl.arrays import Array

_ANY = ReportedStates(
    np.array([[1.0], [2.0], [4.0]]),
    np.array([[3.0], [1.0], [5.0]]),
    np.array([[0.8], [0.4], [0.2], [0.4]]),
    np.array([[2.0], [5.0], [1.0]]),
)


@dataclass(frozen=True, eq=False)
class WrongReading:
    """A fault with particular parameters: its name and sentence, how it reads, and the parameters."""

    name: str
    text: str
    misread: Misread
    values: Array

    @classmethod
    def of(cls, name: str, values: Array) -> WrongReading:
        """Return a wrong reading of the catalogue with these parameters."""
        fault = next(fault for fault in FAULTS if fault.name == name)
        assert isinstance(fault.plant, Misread)
        return cls(name, fault.text(values), fault.plant, values)

    @cached_property
    def quantity(self) -> str:
        """The quantity that is read wrongly; "" for a quaternion that is set wrongly, and read as it is."""
        read = self.apply(_ANY, world_omega=False)
        return "".join(n for n in "xvqw" if not np.array_equal(getattr(read, n), getattr(_ANY, n)))

    def apply(self, reading: ReportedStates, *, world_omega: bool) -> ReportedStates:
        """Return what becomes of a right reading."""
        return self.misread.apply(reading, self.values, world_omega)

    def undo(self, reading: ReportedStates, *, world_omega: bool) -> ReportedStates:
        """Return the right reading."""
        return self.misread.undo(reading, self.values, world_omega)


@cache
def wrong_readings(quantities: str = "xvqw") -> tuple[WrongReading, ...]:
    """Return the wrong readings of these quantities, in the order of the catalogue."""
    plants = ((fault, fault.plant) for fault in FAULTS)
    every = (
        WrongReading(fault.name, text, plant, values)
        for fault, plant in plants
        if isinstance(plant, Misread) and plant.as_set is None
        for values, text in fault.particular
    )
    return tuple(one for one in every if one.quantity and one.quantity in quantities)


def quaternions_as_set() -> Iterator[tuple[str, Callable[[Array], Array]]]:
    """Yield the sentence of each quaternion that is set wrongly and read as it is, and what becomes of it."""
    for fault in FAULTS:
        plant = fault.plant
        if not isinstance(plant, Misread) or plant.as_set is None:
            continue
        if not WrongReading(fault.name, fault.sentence, plant, np.zeros(0)).quantity:
            yield fault.sentence, plant.as_set
