"""Parsing of a single scenario from TOML text."""

from __future__ import annotations

from importlib.resources.abc import Traversable
from pathlib import Path

from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_members

HERE = Path()


def parse_scenario(
    text: str, where: str, folder: Traversable = HERE, *, allow_code: bool = False
) -> Scenario:
    """Return the only scenario of a text; raises the errors of parse_members."""
    return parse_members(text, where, folder, allow_code=allow_code)[None]
