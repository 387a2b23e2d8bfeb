"""bodycheck tells whether a rigid-body engine is right, how right at what speed, and whether that changed.

The public names are imported when they are first used: `import bodycheck` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bodycheck.adapters.registry import register_adapter
    from bodycheck.adapters.step_function import StepState
    from bodycheck.errors import BodycheckError, InputError, UnavailableError
    from bodycheck.reports.run import Run
    from bodycheck.reports.store import write_run
    from bodycheck.runner import judge, run, truth
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
    "BodycheckError": "bodycheck.errors",
    "InputError": "bodycheck.errors",
    "Run": "bodycheck.reports.run",
    "StepState": "bodycheck.adapters.step_function",
    "UnavailableError": "bodycheck.errors",
    "judge": "bodycheck.runner",
    "load_scenario": "bodycheck.scenarios.library",
    "register_adapter": "bodycheck.adapters.registry",
    "run": "bodycheck.runner",
    "truth": "bodycheck.runner",
    "write_run": "bodycheck.reports.store",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its home (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'bodycheck' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
