"""Which answers of earlier runs a run reuses."""

from __future__ import annotations

from typing import Literal, TypeAlias

Reuse: TypeAlias = Literal["nothing", "truths", "installed", "everything"]
"""What is reused: nothing; the truths of scenarios; also the answers of installed engines; also those of all
other engines whose identity is known, including plug-ins and editable installs."""


def reuse_of(fresh: bool | None, default: Reuse) -> Reuse:
    """Return the setting of --fresh or --reuse [default: that of the command]."""
    return default if fresh is None else "nothing" if fresh else "everything"
