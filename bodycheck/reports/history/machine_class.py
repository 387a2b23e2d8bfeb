"""Which nights were measured on machines that are alike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def machine_class(manifest: Mapping[str, Any]) -> str:
    """Return processor, cores, system and architecture: what must be alike for two nights to be compared.

    Versions of the system, of Python and of libraries are circumstances: a change of theirs is to be seen.
    """
    return f"{manifest['cpu']}, {manifest['cores']} cores, {manifest['system']}"
