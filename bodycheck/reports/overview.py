"""One line a method: what it came to over all the scenarios of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from bodycheck.reports.findings import MethodKey
from bodycheck.reports.summary import Cell
from bodycheck.reports.wording import number


@dataclass(frozen=True)
class Overview:
    """What a method came to: its cells by scenario, in the order of the run."""

    method: str
    cells: Mapping[str, Cell]

    @property
    def states(self) -> Counter[str]:
        """How many scenarios came to each state."""
        return Counter(cell.state for cell in self.cells.values())

    @property
    def order(self) -> str:
        """The median of the orders that showed, and their range where there are several."""
        orders = sorted(cell.order for cell in self.cells.values() if cell.order is not None)
        if not orders:
            return ""
        span = f" ({orders[0]:.2f} to {orders[-1]:.2f})" if len(orders) > 1 else ""
        return f"{median(orders):.2f}{span}"

    @property
    def largest_error(self) -> str:
        """The largest orientation error at the scenarios' common steps, and where."""
        errors = [(cell.error, scenario) for scenario, cell in self.cells.items() if cell.error is not None]
        if not errors:
            return ""
        error, scenario = max(errors)
        return f"{number(error, 3)} rad in {scenario}"


def overviews(cells: Mapping[str, Mapping[MethodKey, Cell]]) -> list[Overview]:
    """Return the methods of a summary, in the order of the run."""
    by_method: dict[MethodKey, dict[str, Cell]] = {}
    for scenario, methods in cells.items():
        for key, cell in methods.items():
            by_method.setdefault(key, {})[scenario] = cell
    return [Overview(":".join(key), found) for key, found in by_method.items()]
