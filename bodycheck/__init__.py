"""Measure the accuracy and the speed of rigid-body engines, and detect changes in them.

Public names are imported on first use, so `import bodycheck` is fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bodycheck._util.errors import BodycheckError, InputError, UnavailableError
    from bodycheck.adapters.registry import register_adapter
    from bodycheck.adapters.step_function import StepState
    from bodycheck.reports.run_files.run_tables import Run
    from bodycheck.runs.directory import write_run
    from bodycheck.runs.runner import judge, run, truth
    from bodycheck.scenarios.library import load_scenario

__all__ = [
    "BodycheckError",
    "InputError",
    "Run",
    "StepState",
    "UnavailableError",
    "judge",
    "load_scenario",
    "register_adapter",
    "run",
    "truth",
    "write_run",
]

_HOMES = {
    "BodycheckError": "bodycheck._util.errors",
    "InputError": "bodycheck._util.errors",
    "Run": "bodycheck.reports.run_files.run_tables",
    "StepState": "bodycheck.adapters.step_function",
    "UnavailableError": "bodycheck._util.errors",
    "judge": "bodycheck.runs.runner",
    "load_scenario": "bodycheck.scenarios.library",
    "register_adapter": "bodycheck.adapters.registry",
    "run": "bodycheck.runs.runner",
    "truth": "bodycheck.runs.runner",
    "write_run": "bodycheck.runs.directory",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'bodycheck' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
