"""A Sphinx extension: the project's docstrings are plain text with formulas, and are shown as they stand.

Without it |v|, R^T*, x_ and the like would be taken for markup, and Array | None have no name. A paragraph
that explains arguments or fields, "name: text. other: text.", becomes a list with one entry each.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Collection
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

_CODE = re.compile(r"``?([^`]+)``?")
_MARKUP = re.compile(r"([\\*|_`])")
_PAGE = re.compile(r"\bdocs/([\w-]+)\.md")
_ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")  # how autodoc writes an alias within a union


def escaped(line: str) -> str:
    """Return a line whose text means itself, and what stands in backticks as code."""
    pieces = _CODE.split(line)
    return "".join(f"``{piece}``" if i % 2 else _plain(piece) for i, piece in enumerate(pieces))


def _plain(text: str) -> str:
    """Return text without markup, in which the names of pages, such as docs/workers.md, are links to them."""
    return _PAGE.sub(r":doc:`/\1`", _MARKUP.sub(r"\\\1", text))


def paragraphs(lines: list[str]) -> list[str]:
    """Return the lines escaped; a paragraph that is indented is a formula, and becomes a literal block."""
    shown: list[str] = []
    for text in "\n".join(lines).strip("\n").split("\n\n"):
        if text.startswith(" "):
            shown += ["::", "", *text.split("\n"), ""]
        else:
            shown += [*(escaped(line) for line in text.split("\n")), ""]
    return shown


def entries(lines: list[str], names: Collection[str]) -> list[str]:
    """Return the lines with an entry ":param name: text" for each of these names that a paragraph explains.

    A name begins an entry at the start of a paragraph or after a sentence; several may share one.
    """
    if not names:
        return lines
    one = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    begin = re.compile(rf"(?:^|(?<=[.\])] ))((?:{one})(?:(?:, | and )(?:{one}))*): ")
    shown: list[str] = []
    for text in "\n".join(lines).strip("\n").split("\n\n"):
        flat = " ".join(text.split())
        found = list(begin.finditer(flat))
        if text.startswith((" ", "::")) or not found:
            shown += [*text.split("\n"), ""]
            continue
        if before := flat[: found[0].start()].strip():
            shown += [before, ""]
        ends = [*(next_one.start() for next_one in found[1:]), len(flat)]
        explained = [
            (match[1], flat[match.end() : end].strip()) for match, end in zip(found, ends, strict=True)
        ]
        last, sentence, rest = explained[-1][1].partition(" Raises ")
        explained[-1] = (explained[-1][0], last)
        shown += [*(f":param {name}: {what}" for name, what in explained), ""]
        if sentence:
            shown += [f"Raises {rest}", ""]
    return shown


def _arguments(of: object) -> list[str]:
    """Return the names of the arguments of a function, or of the fields of a class."""
    if inspect.isclass(of):
        return list(getattr(of, "__dataclass_fields__", getattr(of, "model_fields", {})))
    try:
        return list(inspect.signature(of).parameters)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return []


def _show_as_it_stands(
    app: Sphinx, what: str, name: str, of: object, options: object, lines: list[str]
) -> None:
    del app, what, name, options
    lines[:] = entries(paragraphs(lines), _arguments(of))


def _name_aliases(
    app: Sphinx, what: str, name: str, of: object, options: object, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    del app, what, name, of, options
    return tuple(text and _ALIAS.sub(r"\1", text) for text in (signature, returns))


def _separate_by_colons(app: Sphinx, document: nodes.document) -> None:
    """Write "name: text" for the "name -- text" of Sphinx, which without smartquotes is no dash."""
    del app
    for text in list(document.findall(nodes.Text)):
        if text == " -- ":
            text.parent.replace(text, nodes.Text(": "))


def setup(app: Sphinx) -> dict[str, Any]:
    """Show every docstring as it stands."""
    app.connect("autodoc-process-docstring", _show_as_it_stands)
    app.connect("autodoc-process-signature", _name_aliases)
    app.connect("doctree-read", _separate_by_colons)
    return {"parallel_read_safe": True}
