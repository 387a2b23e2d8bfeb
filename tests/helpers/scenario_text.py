"""One scenario out of TOML text, as a file of that name would hold it."""

from __future__ import annotations

from importlib.resources.abc import Traversable
from pathlib import Path

from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_members

HERE = Path()


def parse_scenario(
    text: str, where: str, folder: Traversable = HERE, *, allow_code: bool = False
) -> Scenario:
    """Return the one scenario; raises what parse_members raises."""
    return parse_members(text, where, folder, allow_code=allow_code)[None]
