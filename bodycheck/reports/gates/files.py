"""The gates for other programs: JUnit XML, which CI servers show, and JSON with every number in full."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

from bodycheck.reports.gates.text import failure_rows, line_of
from bodycheck.reports.gates.verdict import Check, GateResult

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def as_junit(results: Sequence[GateResult], where: str) -> bytes:
    """Return a test suite with one test case a gate; what measured nothing is a failure too."""
    failures = sum(result.status != "passed" for result in results)
    counts = {"tests": str(len(results)), "failures": str(failures), "errors": "0", "skipped": "0"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {"name": "bodycheck gate", **counts})
    for place, result in enumerate(results):
        name = f"gate[{place}] {result.gate.title}"
        case = ElementTree.SubElement(suite, "testcase", {"classname": _xml(where), "name": _xml(name)})
        if result.status != "passed":
            failure = ElementTree.SubElement(
                case, "failure", {"type": result.status, "message": _xml(line_of(result))}
            )
            lines = [" | ".join(filter(None, cells[1:])) for cells in failure_rows([result])]
            failure.text = _xml("\n".join([result.gate.reason, *lines]))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _xml(text: str) -> str:
    """Return the text without what XML cannot hold: an engine's message may have anything in it."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def as_json(results: Sequence[GateResult], where: str, run_id: str) -> bytes:
    """Return an object: the file, the run, whether all passed, and each gate with all its rows."""
    told = {
        "tolerances": where,
        "run_id": run_id,
        "passed": all(result.status == "passed" for result in results),
        "gates": [_gate(result) for result in results],
    }
    return (json.dumps(told, indent=1, allow_nan=False) + "\n").encode()


def _gate(result: GateResult) -> dict[str, Any]:
    return {
        "gate": result.gate.model_dump(exclude_none=True),
        "status": result.status,
        "why": result.why,
        "rows": [
            {**vars(check.row), "passed": check.passed, **_beyond(check, result)} for check in result.checks
        ],
    }


def _beyond(check: Check, result: GateResult) -> dict[str, float | None]:
    """Return the distance under the name of its unit; null where there is none, or a side is 0."""
    finite = check.beyond is not None and math.isfinite(check.beyond)
    name = "beyond_decades" if result.gate.looks_at.in_decades else "beyond"
    return {name: check.beyond if finite else None}
