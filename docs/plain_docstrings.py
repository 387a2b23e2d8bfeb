"""A Sphinx extension: the project's docstrings are plain text with formulas, and are shown as they stand.

Without it |v|, R^T*, x_ and the like would be taken for markup, and Array | None have no name.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_CODE = re.compile(r"``?([^`]+)``?")
_MARKUP = re.compile(r"([\\*|_`])")
_ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")  # how autodoc writes an alias within a union


def escaped(line: str) -> str:
    """Return a line whose text means itself, and what stands in backticks as code."""
    pieces = _CODE.split(line)
    return "".join(f"``{piece}``" if i % 2 else _MARKUP.sub(r"\\\1", piece) for i, piece in enumerate(pieces))


def paragraphs(lines: list[str]) -> list[str]:
    """Return the lines escaped; a paragraph that is indented is a formula, and becomes a literal block."""
    shown: list[str] = []
    for text in "\n".join(lines).strip("\n").split("\n\n"):
        if text.startswith(" "):
            shown += ["::", "", *text.split("\n"), ""]
        else:
            shown += [*(escaped(line) for line in text.split("\n")), ""]
    return shown


def _show_as_it_stands(
    app: Sphinx, what: str, name: str, of: object, options: object, lines: list[str]
) -> None:
    del app, what, name, of, options
    lines[:] = paragraphs(lines)


def _name_aliases(
    app: Sphinx, what: str, name: str, of: object, options: object, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    del app, what, name, of, options
    return tuple(text and _ALIAS.sub(r"\1", text) for text in (signature, returns))


def setup(app: Sphinx) -> dict[str, Any]:
    """Show every docstring as it stands."""
    app.connect("autodoc-process-docstring", _show_as_it_stands)
    app.connect("autodoc-process-signature", _name_aliases)
    return {"parallel_read_safe": True}
