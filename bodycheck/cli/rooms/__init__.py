"""The rooms: commands about other things than runs, on which the core does not depend.

Each module of this package has a ROOM. Without the module and its package, such as `audit_command.py` and
`bodycheck/audit/`, the other commands work.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from bodycheck.reports.comparison.release_results import Found
    from bodycheck.reports.document import Document


@dataclass(frozen=True)
class Room:
    """The commands of a room, and what `merge` and `versions` do with its folders and files.

    stores: its results, in the plural. marker: the file by which a folder of them is known.
    merge(folders, out, allow_code) writes the whole and returns the answer. takes_code: whether
    --allow-code applies. releases: finds the releases of an engine in which the answer about a file changed.
    """

    commands: typer.Typer
    stores: str
    marker: str
    merge: Callable[[Sequence[Path], Path, bool], tuple[Document, dict[str, Any]]]
    takes_code: bool = False
    releases: Callable[..., Found] | None = None

    def has_stored(self, folder: Path) -> bool:
        """Whether a folder holds results of this room."""
        return (folder / self.marker).is_file()


@cache
def rooms() -> tuple[Room, ...]:
    """Return all rooms."""
    modules = pkgutil.iter_modules(__path__, f"{__name__}.")
    return tuple(import_module(module.name).ROOM for module in modules)
