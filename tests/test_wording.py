"""Documentation, help and messages avoid the idioms that docs/naming.md replaces by standard terms."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.helpers.doc_pages import pages

ROOT = Path(__file__).parents[1]
IDIOMS = {
    r"\btold\b": "is reported, is detected, [default: ...]",
    r"\btells? of\b": "reports",
    r"\bis none of\b|\bare none of\b|\bis no [a-z]+ of\b": "is not a ...; unknown ... (available: ...)",
    r"\bkeeps? (an|the) error\b": "meets an error tolerance",
    r"\bone (row|line|file|job|process) a [a-z]+": "one ... per ...",
    r"\b(dear|dearest|gravest|quickest)\b": "expensive, most severe, fastest",
    r"\bbeside\b": "next to, relative to, besides",
    r"\basked (anew|again)\b": "run again",
    r"\bgoes on (with|as)\b|\bgo on with\b": "continues",
    r"\banew\b": "again",
    r"\bnights? (before|of)\b|\btonight('s)?\b": "baseline runs, this run",
    r"\ba s\b": "per simulated second",
}
"""Idiom -> its replacement."""


@cache
def prose() -> list[tuple[str, str]]:
    """Return places and their texts: docs without code, templates, scripts, strings but docstrings."""
    return list(_prose())


def _prose() -> Iterator[tuple[str, str]]:
    for page in map(ROOT.joinpath, pages()):
        if page.name == "naming.md":  # this page quotes the idioms
            continue
        text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for number, line in enumerate(text.splitlines(), 1):
            yield f"{page.relative_to(ROOT)}, line {number} without its code", line
    for template in sorted((ROOT / "bodycheck/reports/templates").glob("*.html")):
        text = re.sub(r"\{[{%].*?[%}]\}", "", template.read_text(encoding="utf-8"), flags=re.DOTALL)
        yield str(template.relative_to(ROOT)), text
    scripts = (*(ROOT / ".github").rglob("*.yml"), *(ROOT / "bodycheck/reports/templates").glob("*.js"))
    others = [ROOT / name for name in ("pyproject.toml", ".ci/run", "action.yml", "Containerfile")]
    for folder in ("scripts", "tools", "bodycheck/adapters"):
        suffixes = (".sh", ".mjs", ".py") if folder == "tools" else (".sh", ".mjs")
        others += (path for path in (ROOT / folder).rglob("*") if path.suffix in suffixes)
    for script in sorted((*scripts, *others)):
        for number, line in enumerate(script.read_text(encoding="utf-8").splitlines(), 1):
            yield f"{script.relative_to(ROOT)}, line {number}", line
    for module in sorted((ROOT / "bodycheck").rglob("*.py")):
        tree = ast.parse(module.read_text(encoding="utf-8"))
        documentation = {
            id(node.body[0].value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and id(node) not in documentation
            ):
                yield f"{module.relative_to(ROOT)}:{node.lineno}", node.value


@pytest.mark.parametrize("idiom", IDIOMS)
def test_no_idiom_is_used(idiom: str) -> None:
    """No text for users contains an idiom, because each has a standard term with a single meaning."""
    found = [f"{place}: {text.strip()[:100]}" for place, text in prose() if re.search(idiom, text)]
    assert found == [], f"write {IDIOMS[idiom]}"
