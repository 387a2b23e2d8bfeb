"""What fails, and where, in the formats of code hosting: annotations of GitHub, SARIF, badges."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, TypeAlias
from urllib.parse import quote
from xml.etree import ElementTree

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import count
from bodycheck.reports.document import Document, json_text, markdown

Level: TypeAlias = Literal["error", "warning", "note"]

_LEVELS: dict[Level, str] = {"error": "error", "warning": "warning", "note": "notice"}
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_MOST_SHOWN = 10  # GitHub shows no more annotations of a level per step


@dataclass(frozen=True)
class Alert:
    """One thing that is wrong: a message, whose first line names it, and the place that it refers to.

    rule: the kind of fault, like "gate-failed". file: None if no file states what would be right.
    """

    rule: str
    message: str
    level: Level = "error"
    file: Path | None = None
    line: int = 1


def github_commands(alerts: Sequence[Alert], title: str) -> Iterator[str]:
    """Yield workflow commands of GitHub Actions that annotate the files; the last one counts those left out.

    Message and properties are escaped as in actions/toolkit, packages/core/src/command.ts.
    """
    shown = alerts if len(alerts) <= _MOST_SHOWN else alerts[: _MOST_SHOWN - 1]
    for one in shown:
        place = {} if one.file is None else {"file": _in_workspace(one.file), "line": str(one.line)}
        properties = ",".join(f"{key}={_property(value)}" for key, value in {**place, "title": title}.items())
        yield f"::{_LEVELS[one.level]} {properties}::{_data(one.message)}"
    if rest := alerts[len(shown) :]:
        yield f"::{_LEVELS[rest[0].level]} title={_property(title)}::and {count(len(rest), 'more fault')}"


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


def _in_workspace(file: Path) -> str:
    """Return the path relative to the checkout, as annotations and SARIF need it; else as it is."""
    workspace = Path(os.environ.get("GITHUB_WORKSPACE") or ".").absolute()
    absolute = file.absolute()
    return (absolute.relative_to(workspace) if absolute.is_relative_to(workspace) else file).as_posix()


def add_job_summary(document: Document) -> None:
    """Append a document as Markdown to the summary of a job of GitHub Actions; elsewhere do nothing.

    Raises InputError if it cannot be written.
    """
    path = os.environ.get("GITHUB_STEP_SUMMARY")
    if not path:
        return
    try:
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(f"{markdown(document)}\n")
    except OSError as error:
        fault = error.strerror or error
        raise InputError(f"GITHUB_STEP_SUMMARY {path}: cannot be written: {fault}") from None


def sarif(alerts: Sequence[Alert]) -> str:
    """Return alerts as a log in SARIF 2.1.0 (OASIS, 2020)."""
    rules = sorted({one.rule for one in alerts})
    driver = {
        "name": "bodycheck",
        "version": version("bodycheck"),
        "rules": [{"id": rule, "shortDescription": {"text": rule.replace("-", " ")}} for rule in rules],
    }
    log = {
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [{"tool": {"driver": driver}, "results": [_result(one) for one in alerts]}],
    }
    return json_text(log) + "\n"


def _result(one: Alert) -> dict[str, Any]:
    result = {"ruleId": one.rule, "level": one.level, "message": {"text": one.message}}
    if one.file is None:
        return result
    uri = quote(_in_workspace(Path(os.path.relpath(one.file))))
    place = {"artifactLocation": {"uri": uri}, "region": {"startLine": max(one.line, 1)}}
    return {**result, "locations": [{"physicalLocation": place}]}


def junit(alerts: Sequence[Alert], suite: str) -> bytes:
    """Return a JUnit test suite with one failed test case per alert, or one that passed."""
    counts = {"tests": str(max(len(alerts), 1)), "failures": str(len(alerts)), "errors": "0"}
    root = ElementTree.Element("testsuites", counts)
    node = ElementTree.SubElement(root, "testsuite", {"name": suite, **counts})
    for one in alerts:
        first = xml_text(one.message).partition("\n")[0]
        case = ElementTree.SubElement(node, "testcase", {"classname": suite, "name": first})
        failure = ElementTree.SubElement(case, "failure", {"type": one.rule, "message": first})
        failure.text = xml_text(one.message)
    if not alerts:
        ElementTree.SubElement(node, "testcase", {"classname": suite, "name": "no regression"})
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def xml_text(text: str) -> str:
    """Return the text without characters that XML forbids: an engine's message may contain any."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def badge(message: str, *, good: bool) -> str:
    """Return a badge for https://img.shields.io/endpoint?url=..., as JSON."""
    facts = {"schemaVersion": 1, "label": "bodycheck", "message": message}
    return json_text({**facts, "color": "brightgreen" if good else "red"}) + "\n"
