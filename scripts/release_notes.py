"""Print the section of CHANGELOG.md of a tag, `python scripts/release_notes.py v0.2.0`.

Exit status 1 with one line if the tag is not the version of pyproject.toml, or if the changelog has no
section of it or an empty one.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def notes(tag: str, changelog: str, version: str) -> str:
    """Return the section of a tag without its title; raises ValueError if there is none."""
    if tag != f"v{version}":
        raise ValueError(f"{tag}: pyproject.toml has version {version}, whose tag is v{version}")
    sections = re.split(r"^## ", changelog, flags=re.MULTILINE)
    found = [section for section in sections if re.match(rf"{re.escape(version)}( |\n)", section)]
    if len(found) != 1:
        raise ValueError(f"{tag}: CHANGELOG.md has {len(found)} sections `## {version}`, which must be one")
    _, _, text = found[0].partition("\n")
    if not re.search(r"^- ", text, flags=re.MULTILINE):
        raise ValueError(f"{tag}: the section of CHANGELOG.md has no entry")
    return text.strip() + "\n"


def main() -> int:
    """Print the notes of the tag on the command line."""
    if len(sys.argv) != 2:
        print("usage: python scripts/release_notes.py TAG", file=sys.stderr)
        return 2
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    try:
        text = notes(sys.argv[1], (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), project["version"])
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
