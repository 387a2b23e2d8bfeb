"""The README and the docs as blocks of code, and the commands in them with the output that they promise."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
_FENCED = re.compile(r"^```([^\n]*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """What stands between two fences of a page, by the language that the first one names."""

    page: str
    language: str
    text: str


@dataclass(frozen=True)
class Command:
    """A line for a shell, and what it prints on a terminal; None where the page does not say."""

    line: str
    prints: str | None = None


def pages() -> list[str]:
    """Return the pages whose blocks are run, as paths within the repository."""
    docs = (page for page in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in page.parts)
    return ["README.md", "CONTRIBUTING.md", *(page.relative_to(ROOT).as_posix() for page in docs)]


def text_of(page: str) -> str:
    """Return a page."""
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str, *languages: str) -> list[Block]:
    """Return the blocks of a page in these languages, in their order; of all languages, if none is named."""
    found = [Block(page, language, text) for language, text in _FENCED.findall(text_of(page))]
    return [block for block in found if not languages or block.language in languages]


def commands(page: str) -> list[Command]:
    """Return what a page shows to a shell: lines of sh blocks, and what follows $ in console blocks."""
    return [command for block in blocks(page, "sh", "console") for command in _commands(block)]


def _commands(block: Block) -> list[Command]:
    if block.language == "sh":
        return [Command(line) for line in block.text.splitlines() if line.strip()]
    shown = re.split(r"^\$ ", block.text, flags=re.MULTILINE)
    assert shown[0] == "", f"{block.page}: a console block begins with $"
    split = (one.partition("\n") for one in shown[1:])
    return [Command(line, prints) for line, _, prints in split]


def has_tests(block: Block) -> bool:
    """Whether a Python block is a file of tests, and not a script."""
    return block.language == "python" and re.search(r"^def test_", block.text, flags=re.MULTILINE) is not None
