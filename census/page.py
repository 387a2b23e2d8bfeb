"""The pages of the documentation and the reports, made of the data of this folder."""

from __future__ import annotations

import csv
import textwrap
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from bodycheck._util.files import write_file
from census.finding import DRIVERS, HERE, INPUTS, KINDS, Finding, engines_of, read_findings
from census.imports import WHAT, read_imports
from census.models import ModelError, read_errors
from census.releases import HEADER, changes, read_releases, spans
from census.standalone import program

_REPOSITORY = "https://github.com/bodycheck/bodycheck/blob/main/census"
_LANGUAGES = {".toml": "toml", ".csv": "text"}
"""Of the input files; the others are XML."""
_WAYS = {
    "command": "bodycheck's command",
    "driver": "a driver without bodycheck, which compares with a closed form or with the file",
    "source": "the engine's own source",
}


def write_pages(folder: Path) -> list[Path]:
    """Write the index, one page per engine, and those of models, numbers and releases; remove others."""
    findings = read_findings()
    pages = {
        "index": index_of(findings),
        "models": models_page(),
        "numbers": "\n".join(["# Published reference numbers", "", *_text_and_table("numbers"), ""]),
        "releases": releases_page(),
    }
    pages |= {name: engine_page(name, findings) for name in engines_of(findings)}
    folder.mkdir(exist_ok=True)
    for path in folder.glob("*.md"):
        if path.stem not in pages:
            path.unlink()
    written = []
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            write_file(path, text.encode())
        written.append(path)
    return written


def index_of(findings: Mapping[str, Finding]) -> str:
    """Return the page that opens with the counts, then lists all findings."""
    errors, withdrawn = read_errors(), _texts("withdrawn")
    kinds = Counter(one.kind for one in findings.values())
    ways = Counter(way for one in findings.values() for way in one.ways)
    private = sum(not one.is_public for one in findings.values())
    lines = [
        "# Findings",
        "",
        f"{len(findings)} findings in {len(engines_of(findings))} engines: "
        + ", ".join(f"{kinds[kind]} {_plural(kind, kinds[kind])}" for kind in KINDS)
        + f"; {private} of them in no public issue or page that was found. "
        f"{len(errors)} certain errors in models of {len({one.package for one in errors})} packages.",
        "",
        *_changes("Changed in the newest releases", only_newest=True),
        "`python -m census reproduce` runs the command and the driver of each finding in the release that is "
        "named, each in an environment of its own, and compares the figures. "
        "`python -m census report NAME` prints a text that can be reported upstream.",
        "",
        *(line for kind in KINDS for line in _of_kind(kind, findings)),
        "## Chains",
        "",
        *_text_and_table("chains"),
        "",
        "## How we can be wrong",
        "",
        "Each finding was seen in at least two independent ways:",
        "",
        *(f"- {text}: {ways[way]} findings" for way, text in _WAYS.items()),
        "",
        *_texts("withdrawn")["text"],
        "",
        *(_prose(f"- {one['title']} ({one['engine']}): {one['reason']}") for one in withdrawn["finding"]),
        "",
        "```{toctree}",
        ":hidden:",
        "",
        *engines_of(findings),
        "models",
        "numbers",
        "releases",
        "```",
    ]
    return "\n".join([*lines, ""])


def _of_kind(kind: str, findings: Mapping[str, Finding]) -> list[str]:
    """Return the section of one kind: what it means, and its findings by engine."""
    found = sorted((one for one in findings.values() if one.kind == kind), key=lambda one: one.engine)
    rows = (
        (f"[{one.title}]({one.engine}.md#{one.name}), {one.engine} {one.releases}", one.size) for one in found
    )
    return [
        f"## {_plural(kind, 2).capitalize()}",
        "",
        f"{len(found)} in which {KINDS[kind]}.",
        "",
        *_table(("finding, and the releases that have it", "how large"), rows),
        "",
    ]


def engine_page(engine: str, findings: Mapping[str, Finding]) -> str:
    """Return the page of one engine: its findings with all that is needed to see them, defects first."""
    lines = [f"# Findings in {engine}", ""]
    for one in sorted(findings.values(), key=lambda one: list(KINDS).index(one.kind)):
        if one.engine == engine:
            lines += [f"({one.name})=", f"## {_prose(one.title)}", "", *_body(one, links=True)]
    return "\n".join(lines)


def report_of(finding: Finding) -> str:
    """Return the text of one finding as an issue upstream could have it."""
    return "\n".join([f"# {_prose(finding.title)}", "", *_body(finding, links=False)]).rstrip()


def _body(one: Finding, *, links: bool) -> list[str]:
    """Return the text of a finding; links: for the pages, else for upstream, the engine alone first."""
    if links:
        known = f"<{one.upstream}>" if one.is_public else f"none found by a search for: {one.searched}"
        lines = [f"**{one.kind.capitalize()}** in {one.engine} {one.releases}.", ""]
        lines += [f"**How large:** {_prose(one.size)}.", "", f"**Public issue or page:** {known}.", ""]
    else:
        lines = [f"{one.engine} {one.releases}. How large: {_prose(one.size)}.", ""]
    lines += [f"**Expected:** {_prose(one.expected)}", "", f"**Found:** {_prose(one.found)}", ""]
    ways = [_command(one), _driver(one, links=links)]
    lines += [line for way in (ways if links else reversed(ways)) for line in way]
    if one.source:
        lines += [f"**In the source:** {_prose(one.source)}", ""]
    if links:
        lines += [f"As a text for upstream: `python -m census report {one.name}`", ""]
    elif one.is_public:
        lines += [f"This is public already: {one.upstream}", ""]
    return lines


def _command(one: Finding) -> list[str]:
    """Return bodycheck's command and its input files."""
    lines = ["**With bodycheck:**", "", "```text", one.command, "```", ""] if one.command else []
    for name in one.inputs:
        language = _LANGUAGES.get(Path(name).suffix, "xml")
        text = (INPUTS / name).read_text(encoding="utf-8").rstrip()
        lines += [f"`{name}`:", "", f"```{language}", text, "```", ""]
    return lines


def _driver(one: Finding, *, links: bool) -> list[str]:
    """Return what the driver prints, and the driver; links: folded, with the address of its file."""
    if not one.driver:
        return []
    name, experiment = one.driver.split()
    file = name if name.endswith(".mjs") else f"{name}.py"
    figures = ", ".join(f"{figure:.5g}" for figure in one.driver_figures)
    code = _code_of(DRIVERS / file, experiment)
    if not links:
        return [f"**The engine alone** prints {figures}:", "", *code]
    place = f"[`drivers/{file}`]({_REPOSITORY}/drivers/{file})"
    return [
        f"**The engine alone** prints {figures}: `{experiment}` of {place}.",
        "",
        "<details><summary>As a program</summary>",
        "",
        *code,
        "</details>",
        "",
    ]


def _code_of(path: Path, experiment: str) -> list[str]:
    """Return an experiment as a block of code: a program in Python, the function alone in JavaScript."""
    if path.suffix == ".py":
        return ["```python", program(path, experiment), "```", ""]
    text = path.read_text(encoding="utf-8")
    start = text.index(f"  async {experiment}(")
    return ["```js", textwrap.dedent(text[start : text.index("\n  },", start)]) + "\n}", "```", ""]


def _prose(text: str) -> str:
    """Return text in which the names of elements are not taken for HTML, nor products for emphasis."""
    return text.replace("<", "&lt;").replace("*", "\\*")


def models_page() -> str:
    """Return the page of published models: what importers make of them, and the errors in them."""
    errors = read_errors()
    rows = Counter((f"{one.package} {one.version}", one.rule) for one in errors)
    rules = sorted({rule for _, rule in rows})
    return "\n".join(
        [
            "# Published models",
            "",
            f"{len(errors)} errors are certain and confirmed: numbers that no body has. "
            "`bodycheck audit FILE --lint` reports each; `python -m census models` installs the packages and "
            "keeps what exact arithmetic on the fractions in the file confirms by another reader.",
            "",
            *_table(
                ("package", *rules),
                (
                    (name, *(rows[name, rule] or "" for rule in rules))
                    for name in sorted({n for n, _ in rows})
                ),
            ),
            "",
            *(line for package in sorted({name for name, _ in rows}) for line in _errors_of(package, errors)),
            "## What importers make of them",
            "",
            *_texts("imports")["text"],
            "",
            *_imports_by_package(),
            "",
            *_imports_by_cause(),
            "",
        ]
    )


def _errors_of(package: str, errors: Sequence[ModelError]) -> list[str]:
    """Return the errors of a package, folded; files by their last two names, as models.csv has them whole."""
    own = [one for one in errors if f"{one.package} {one.version}" == package]
    rows = (
        (f"{'/'.join(one.file.split('/')[-2:])}:{one.line}", one.link, one.message, one.confirmed)
        for one in own
    )
    return [
        f"<details><summary>Errors in {package}: {len(own)}</summary>",
        "",
        *_table(("file and line", "link", "error", "confirmed by"), rows),
        "",
        "</details>",
        "",
    ]


def _imports_by_package() -> list[str]:
    """Return how many files each importer reads of each package, and how many links and joints it holds."""
    counts: dict[tuple[str, str], Counter[tuple[str, bool]]] = {}
    for one in read_imports():
        if not one.cause and one.state != "merged":
            key = (f"{one.package} {one.version}", f"{one.importer} {one.release}")
            held = one.state in ("read", "agrees", "rounded")
            counts.setdefault(key, Counter())[one.what, held] += one.count
    return _table(
        ("package", "importer", "files read", "links held", "joints held"),
        (
            (*key, *(f"{of[what, True]} of {of[what, True] + of[what, False]}" for what in WHAT))
            for key, of in counts.items()
        ),
    )


def _imports_by_cause() -> list[str]:
    """Return how often each importer has each cause, over all packages, the most frequent first."""
    counts: dict[tuple[str, str, str], list[int]] = {}
    packages: dict[tuple[str, str, str], set[str]] = {}
    for one in read_imports():
        if one.cause:
            key = (one.importer, one.what, one.cause)
            sums = counts.setdefault(key, [0, 0])
            sums[0] += one.count
            sums[1] += one.files
            packages.setdefault(key, set()).add(one.package)
    rows = sorted(counts, key=lambda key: -counts[key][0])
    return _table(
        ("importer", "of a", "cause", "times", "files", "packages"),
        ((*key, *counts[key], ", ".join(sorted(packages[key]))) for key in rows),
    )


def releases_page() -> str:
    """Return the page of releases: what changed, then the stretches without a change."""
    rows = read_releases()
    return "\n".join(
        [
            "# Releases of engines",
            "",
            *_texts("releases")["text"],
            "",
            *_changes("What changed", only_newest=False),
            *_table(HEADER, (list(one.values()) for one in spans(rows))),
            "",
        ]
    )


def _text_and_table(name: str) -> list[str]:
    return [*_texts(name)["text"], "", *_table_of(name)]


def _table_of(name: str) -> list[str]:
    with (HERE / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return _table(header, rows)


def _changes(title: str, *, only_newest: bool) -> list[str]:
    """Return in what a measured release differs from the one before it: all, or the newest of each engine."""
    rows = read_releases()
    newest = {row["engine"]: row["release"] for row in rows}
    found = [text for engine, release, text in changes(rows) if not only_newest or newest[engine] == release]
    return [f"{title}:", "", *(f"- {one}" for one in found), ""] if found else []


def _texts(name: str) -> dict[str, list]:  # type: ignore[type-arg]
    texts: dict[str, dict[str, list]] = tomllib.loads((HERE / "texts.toml").read_text(encoding="utf-8"))  # type: ignore[type-arg]
    return texts[name]


def _plural(kind: str, count: int) -> str:
    return kind if count == 1 else {"property": "properties"}.get(kind, f"{kind}s")


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    cells = [[str(one).replace("|", "\\|").replace("<", "&lt;") for one in row] for row in rows]
    return [
        f"| {' | '.join(header)} |",
        "|---" * len(header) + "|",
        *(f"| {' | '.join(row)} |" for row in cells),
    ]
