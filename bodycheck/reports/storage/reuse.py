"""What of earlier runs a run uses."""

from __future__ import annotations

from typing import Literal, TypeAlias

Reuse: TypeAlias = Literal["nothing", "truths", "installed", "everything"]
"""nothing; the truths of scenarios; the answers of installed engines too; the answers of all engines whose
identity is known, plug-ins and editable ones included."""


def reuse_of(fresh: bool | None, default: Reuse) -> Reuse:
    """Return what --fresh or --reuse asks for; where neither is given, the default of a command."""
    return default if fresh is None else "nothing" if fresh else "everything"
