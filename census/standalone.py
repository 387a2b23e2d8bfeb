"""An experiment of a driver with all that it uses, as a program of one file: what a report upstream shows."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from pathlib import Path

from census.finding import DRIVERS

_SHARED = "exact"
"""The module of census/drivers whose definitions drivers import; other imports are of installed packages."""


def program(path: Path, experiment: str) -> str:
    """Return an experiment of a Python driver with the definitions that it uses, as a program."""
    parts, imports = _needed(path, {experiment})
    top = "\n".join(["from __future__ import annotations", "", *sorted(imports, key=_order)])
    return "\n\n\n".join([top, *parts, f"print({experiment}())"])


def _needed(path: Path, names: set[str]) -> tuple[list[str], set[str]]:
    """Return the source of what defines these names and all that it uses, in order, and the imports."""
    text = path.read_text(encoding="utf-8")
    body = ast.parse(text).body
    used, before = set(names), set[str]()
    while used != before:
        before = set(used)
        chosen = [node for node in body if _is_setting(node) or used & set(_defined(node))]
        used |= {name for node in chosen for name in _read(node)}
    parts = [ast.get_source_segment(text, node) or "" for node in chosen]
    imports, shared = set[str](), set[str]()
    for node in body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            wanted = [one for one in node.names if (one.asname or one.name.partition(".")[0]) in used]
            if isinstance(node, ast.ImportFrom) and node.module == _SHARED:
                shared |= {one.name for one in wanted}
            else:
                imports |= {ast.unparse(_only(node, [one])) for one in wanted}
    if shared:
        others, more = _needed(DRIVERS / f"{_SHARED}.py", shared)
        parts, imports = others + parts, imports | more
    return parts, imports


def _only(node: ast.Import | ast.ImportFrom, names: list[ast.alias]) -> ast.stmt:
    return ast.ImportFrom(node.module, names, 0) if isinstance(node, ast.ImportFrom) else ast.Import(names)


def _defined(node: ast.stmt) -> Iterable[str]:
    """Return the names that a statement defines."""
    if isinstance(node, ast.FunctionDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else []
    return [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]


def _read(node: ast.stmt) -> set[str]:
    """Return the names that a statement reads and does not itself assign."""
    names = [one for one in ast.walk(node) if isinstance(one, ast.Name)]
    return {one.id for one in names if isinstance(one.ctx, ast.Load)} - {
        one.id for one in names if isinstance(one.ctx, ast.Store)
    }


def _is_setting(node: ast.stmt) -> bool:
    """Return whether a statement sets an attribute of a package, such as its verbosity."""
    return isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute)


def _order(line: str) -> tuple[bool, str]:
    return line.startswith("from"), line
