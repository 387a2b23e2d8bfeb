"""The Atom feed of a history: one entry per nightly run with a regression (RFC 4287)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from bodycheck._util.files import write_file
from bodycheck._util.formatting import count
from bodycheck.reports.history.archive import started_at

FILE = "feed.xml"
"""The name of the feed in the folder of a history."""

_ATOM = "http://www.w3.org/2005/Atom"
_ENTRIES = 50
_NEVER = datetime(1970, 1, 1, tzinfo=UTC)


def write_feed(folder: Path, runs: Iterable[Mapping[str, Any]]) -> None:
    """Write the feed of the newest regressions atomically; raises InputError if it cannot be written.

    runs: the content of each night.json, the oldest first.
    """
    write_file(folder / FILE, feed(runs))


def feed(runs: Iterable[Mapping[str, Any]]) -> bytes:
    """Return the feed of the newest regressions; its links are relative to the folder of the history."""
    regressions = [run for run in runs if run["status"] == "regression"][::-1][:_ENTRIES]
    updated = started_at(regressions[0]["run_id"]) if regressions else _NEVER
    root = ET.Element("feed", xmlns=_ATOM)
    _describe(root, "urn:bodycheck:history", "bodycheck: regressions", updated)
    ET.SubElement(ET.SubElement(root, "author"), "name").text = "bodycheck"
    ET.SubElement(root, "link", rel="self", href=FILE)
    for run in regressions:
        entry = ET.SubElement(root, "entry")
        changes = f"{run['worse']} worse, {run['missing']} no longer measured"
        _describe(entry, f"urn:bodycheck:{run['run_id']}", changes, started_at(run["run_id"]))
        ET.SubElement(entry, "link", rel="alternate", href=f"{run['run_id']}/night.html")
        summary = f"{count(run['cases'], 'case')} of {run['engines']} on {run['machine']}"
        ET.SubElement(entry, "summary").text = summary
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _describe(parent: ET.Element, identity: str, title: str, updated: datetime) -> None:
    for name, text in (("id", identity), ("title", title), ("updated", updated.isoformat())):
        ET.SubElement(parent, name).text = text
