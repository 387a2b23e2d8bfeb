"""The blocks of code in the README and the docs, and the commands in them with their promised output."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
GENERATED = {"_build", "commands", "findings", "notebooks"}
"""Folders of docs/ whose pages are made by docs/generated_pages.py, or are no sources."""
_FENCED = re.compile(r"^```([^\n]*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """The text between two fences of a page, with the language that the first fence names."""

    page: str
    language: str
    text: str


@dataclass(frozen=True)
class Command:
    """A shell command and its output on a terminal; None if the page does not state the output."""

    line: str
    prints: str | None = None


def pages() -> list[str]:
    """Return the pages whose blocks are run, as paths within the repository."""
    docs = (page for page in sorted((ROOT / "docs").rglob("*.md")) if not GENERATED & set(page.parts))
    return ["README.md", "CONTRIBUTING.md", *(page.relative_to(ROOT).as_posix() for page in docs)]


def text_of(page: str) -> str:
    """Return the text of a page."""
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str, *languages: str) -> list[Block]:
    """Return the blocks of a page in these languages, in order; without a language, all blocks."""
    found = [Block(page, language, text) for language, text in _FENCED.findall(text_of(page))]
    return [block for block in found if not languages or block.language in languages]


def commands(page: str) -> list[Command]:
    """Return the shell commands of a page: the lines of sh blocks, and what follows $ in console blocks."""
    return [command for block in blocks(page, "sh", "console") for command in _commands(block)]


def _commands(block: Block) -> list[Command]:
    if block.language == "sh":
        return [Command(line) for line in block.text.splitlines() if line.strip()]
    shown = re.split(r"^\$ ", block.text, flags=re.MULTILINE)
    assert shown[0] == "", f"{block.page}: a console block begins with $"
    split = (one.partition("\n") for one in shown[1:])
    return [Command(line, prints) for line, _, prints in split]


def has_tests(block: Block) -> bool:
    """Return whether a Python block is a file of tests, rather than a script."""
    return block.language == "python" and re.search(r"^def test_", block.text, flags=re.MULTILINE) is not None
