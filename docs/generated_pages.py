"""A Sphinx extension: pages of commands, measures, notebooks and findings, and the JSON Schemas.

All of them are made of the program itself, and of census/, when the docs are built, in docs/commands/,
docs/notebooks/ and docs/findings/.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from typer.main import get_command

from bodycheck.cli.commands import app as bodycheck
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.runs.schemas import SCHEMAS
from census.page import write_pages

Command = Any


def commands(group: Command, prefix: str = "bodycheck") -> Iterator[tuple[str, str, Command]]:
    """Yield the name, the group of the help and the command of each command, also within groups."""
    for name, command in group.commands.items():
        if command.hidden:
            continue
        words = f"{prefix} {name}"
        if hasattr(command, "commands"):
            for inner, _, found in commands(command, words):
                yield inner, command.rich_help_panel, found
        else:
            yield words, command.rich_help_panel, command


def file_of(name: str) -> str:
    """Return the file of a command's page: history-accept for bodycheck history accept."""
    return name.removeprefix("bodycheck ").replace(" ", "-")


def linked(text: str) -> str:
    """Return text of the help in which the names of pages, such as docs/workers.md, are links to them."""
    return re.sub(r"\bdocs/([\w-]+)\.md", r"[](../\1.md)", text)


def cell(text: str) -> str:
    """Return text for a cell of a Markdown table."""
    return linked(" ".join(text.replace("|", "\\|").replace("<", "&lt;").split()))


def page_of(name: str, command: Command) -> str:
    """Return the page of a command: what it does, its usage, arguments, options by group, and examples."""
    context = command.make_context(name, [], resilient_parsing=True)
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    lines = [f"# `{name}`", "", *paragraphs(command.help or ""), "", "```text", usage, "```", ""]
    rows: dict[str, list[tuple[str, str]]] = {}
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is None:
            continue
        is_argument = parameter.param_type_name == "argument"
        panel = getattr(parameter, "rich_help_panel", None)
        title = "Arguments" if is_argument else panel if isinstance(panel, str) else "Options"
        rows.setdefault(title, []).append(record)
    lines += [f"```{{program}} {name}", "```", ""]
    for title, records in sorted(rows.items(), key=lambda one: (one[0] != "Arguments", one[0] == "Options")):
        lines += [f"## {title}", ""]
        if title == "Arguments":
            lines += ["| name | meaning |", "|---|---|"]
            names = (argument.replace("|", "\\|") for argument, _ in records)
            lines += [f"| `{one}` | {cell(what)} |" for one, (_, what) in zip(names, records, strict=True)]
            lines.append("")
        else:  # directives, so that the search finds options by name
            for option, meaning in records:
                lines += [f"```{{option}} {option.replace(' / ', ', ')}", cell(meaning), "```", ""]
    if command.epilog:
        lines += ["## Examples", "", "```sh", command.epilog, "```", ""]
    return "\n".join(lines)


def paragraphs(text: str) -> list[str]:
    """Return help text as Markdown, in which the characters of markup mean themselves."""
    return [linked(line.replace("<", "&lt;").replace("*", "\\*")) for line in text.split("\n")]


def index_of(found: list[tuple[str, str, Command]]) -> str:
    """Return the page that lists all commands by group."""
    lines = [
        "# The commands",
        "",
        "[Exit status](../questions.md#exit-status): 0 done; 1 a gate, a check or a comparison failed; 2 the "
        "input was wrong; 3 a history has no run to compare with; 70 an internal error; 129, 130, 143 a "
        "signal stopped it; 141 the reader of the output exited first.",
        "",
        "`bodycheck COMMAND --help` prints the same as these pages.",
        "",
    ]
    for group in dict.fromkeys(panel for _, panel, _ in found):
        lines += [f"## {group}", "", "| command | what it does |", "|---|---|"]
        of_group = [(name, command) for name, panel, command in found if panel == group]
        for name, command in of_group:
            what = cell(command.short_help or command.get_short_help_str(200))
            lines.append(f"| [`{name}`]({file_of(name)}.md) | {what} |")
        lines.append("")
    tree = "\n".join(file_of(name) for name, _, _ in found)
    return "\n".join([*lines, "```{toctree}", ":hidden:", "", tree, "measures", "```", ""])


def table_of_measures() -> str:
    """Return the page with one row per measure."""
    lines = [
        "# Table of measures",
        "",
        "Every measure of results.csv; [Measures, orders and verdicts](../measures.md) explains them.",
        "",
        "| measure | formula | columns | SI unit | judged by |",
        "|---|---|---|---|---|",
    ]
    for one in MEASURES.values():
        columns = "<br>".join(f"`{column}`" for column in one.columns)
        judged = {"limit": "its limit", "property": "property", None: "not judged"}[one.judged]
        formula = one.formula.replace("|", "\\|").replace("`", "")
        lines.append(f"| `{one.name}` | `{formula}` | {columns} | {one.unit or '1'} | {judged} |")
    return "\n".join([*lines, ""])


def notebook_page(file: Path) -> str:
    """Return a notebook as Markdown: its text, its code, and the output that it is stored with."""
    lines = []
    for part in json.loads(file.read_text(encoding="utf-8"))["cells"]:
        text = "".join(part["source"])
        if part["cell_type"] == "markdown":
            lines += [text, ""]
            continue
        lines += ["```python", text, "```", ""]
        shown = "".join("".join(output.get("text", "")) for output in part["outputs"]).rstrip()
        if shown:
            lines += ["```text", shown, "```", ""]
    download = f"The notebook itself: {{download}}`{file.name} <{file.name}>`."
    return "\n".join([*lines, download, ""])


def write(path: Path, text: str) -> None:
    """Write a page if it is new or changed, so that only changed pages are built again."""
    path.parent.mkdir(exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def generate(sphinx: Sphinx) -> None:
    """Write all generated pages; remove those of commands that no longer exist."""
    folder = Path(sphinx.srcdir) / "commands"
    found = list(commands(get_command(bodycheck)))
    pages = {file_of(name): page_of(name, command) for name, _, command in found}
    pages |= {"index": index_of(found), "measures": table_of_measures()}
    for name, text in pages.items():
        write(folder / f"{name}.md", text)
    for path in folder.glob("*.md"):
        if path.stem not in pages:
            path.unlink()
    for notebook in (Path(sphinx.srcdir) / "notebooks").glob("*.ipynb"):
        write(notebook.with_suffix(".md"), notebook_page(notebook))
    write_pages(Path(sphinx.srcdir) / "findings")


def write_schemas(sphinx: Sphinx, error: Exception | None) -> None:
    """Write the JSON Schemas to the addresses that they state."""
    if error is None and sphinx.builder.format == "html":
        folder = Path(sphinx.outdir) / "schemas"
        folder.mkdir(exist_ok=True)
        for schema in SCHEMAS.values():
            text = json.dumps(schema.document, indent=1) + "\n"
            (folder / schema.document["$id"].rpartition("/")[2]).write_text(text, encoding="utf-8")


def setup(sphinx: Sphinx) -> dict[str, Any]:
    """Generate the pages before the sources are read."""
    sphinx.connect("builder-inited", generate)
    sphinx.connect("build-finished", write_schemas)
    return {"parallel_read_safe": True}
