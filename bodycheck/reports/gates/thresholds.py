"""The size above which a change is worse or improved: one relative threshold, others for single measures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

THRESHOLD = 0.02
"""Relative to the smaller of the two values; a smaller change is `moved`."""

ORDER_THRESHOLD = 0.1
"""The threshold of orders, which are compared by their difference."""

_ABSOLUTE = "_abs"


@dataclass(frozen=True)
class Thresholds:
    """The threshold of each measure.

    default: relative. of_measure: of single measures, `stability.dt_stable_s` and `relative_cpu`, relative;
    of `order.MEASURE`, a difference of orders. A column `_abs` shares the threshold of its measure.
    """

    default: float = THRESHOLD
    of_measure: Mapping[str, float] = field(default_factory=dict)

    def of(self, measure: str) -> float:
        """Return the threshold of a measure."""
        pure = measure.removesuffix(_ABSOLUTE)
        return self.of_measure.get(measure, self.of_measure.get(pure, self.default))

    def of_order(self, quantity: str) -> float:
        """Return by how much the order of a quantity may lie below theory."""
        return self.of_measure.get(f"order.{quantity}", ORDER_THRESHOLD)


DEFAULT_THRESHOLDS = Thresholds()
