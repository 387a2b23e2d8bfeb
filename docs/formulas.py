"""A Sphinx extension: formulas as MathML, which browsers draw without the network; numbers on one line."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

_NUMBER = re.compile(r"(\d[\d.]*e-\d+)")


def inline(translator: Any, node: nodes.math) -> None:
    """Write a formula within a line."""
    translator.body.append(convert(node.astext(), display="inline"))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.math_block) -> None:
    """Write a formula on lines of its own; it breaks at wide spaces, which separate its parts."""
    parts = "".join(convert(part, display="block") for part in node.astext().split(r"\qquad"))
    translator.body.append(f'<div class="math-block">{parts}</div>\n')
    raise nodes.SkipNode


def keep_numbers(sphinx: Sphinx, document: nodes.document) -> None:
    """Mark the numbers like 1e-3 of paragraphs and tables, which would break after the hyphen."""
    del sphinx
    for text in list(document.findall(nodes.Text)):
        pieces = _NUMBER.split(text)
        if len(pieces) > 1 and isinstance(text.parent, nodes.paragraph | nodes.strong | nodes.emphasis):
            marked = [
                nodes.inline("", piece, classes=["number"]) if i % 2 else nodes.Text(piece)
                for i, piece in enumerate(pieces)
            ]
            text.parent.replace(text, marked)


def setup(sphinx: Sphinx) -> dict[str, Any]:
    """Replace the renderers of formulas, and mark numbers."""
    sphinx.connect("doctree-read", keep_numbers)
    sphinx.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(block, None))
    return {"parallel_read_safe": True}
