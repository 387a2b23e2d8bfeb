"""The findings that a run reports about its methods."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bodycheck.reports.run_files.run_tables import Run
    from bodycheck.reports.summary.worst_results import Result


def reported_results(run: Run) -> dict[str, tuple[Result, ...]]:
    """Return the results of engine:method, the worst first; a healthy method has none."""
    # imported late: workers of the faulty engines import this module, and need no pandas
    from bodycheck.reports.summary.sentences import Summary

    return {one.method: one.results for one in Summary.of(run).worst}
