"""What a run reports of its methods: the findings, and the pages that must name them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bodycheck.reports.run_files.run_tables import Run
    from bodycheck.reports.summary.worst_results import Result


def results_of(run: Run) -> dict[str, tuple[Result, ...]]:
    """Return what was found of engine:method, the worst first; a method that is healthy has nothing."""
    # late: the workers of the faulty engines come by here, and need no pandas
    from bodycheck.reports.summary.worst_results import worst_methods

    return {one.method: one.results for one in worst_methods(run)}
