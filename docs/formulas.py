"""A Sphinx extension: formulas as MathML, which browsers draw without a script and without the network."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx


def inline(translator: Any, node: nodes.math) -> None:
    """Write a formula within a line."""
    translator.body.append(convert(node.astext(), display="inline"))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.math_block) -> None:
    """Write a formula on lines of its own; it breaks at wide spaces, which separate its parts."""
    parts = "".join(convert(part, display="block") for part in node.astext().split(r"\qquad"))
    translator.body.append(f'<div class="math-block">{parts}</div>\n')
    raise nodes.SkipNode


def setup(sphinx: Sphinx) -> dict[str, Any]:
    """Replace the renderers of formulas."""
    sphinx.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(block, None))
    return {"parallel_read_safe": True}
