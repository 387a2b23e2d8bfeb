"""The results of gates as a document, as JUnit XML and as data."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from bodycheck._util.formatting import count, number
from bodycheck.reports.alerts import Alert, badge, xml_text
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.gates.proposal import BoundChange
from bodycheck.reports.gates.verdict import GateCheck, GateResult, GateRow, at_of, distance
from bodycheck.reports.run_files.run_tables import (
    FAILED_CASES,
    FAILED_CHECKS,
    StudyKey,
    Tables,
    failed_case,
    study_key,
)
from bodycheck.reports.table_layout import Column, Span


def as_junit(results: Sequence[GateResult], where: str) -> bytes:
    """Return a JUnit test suite with one test case per gate; a gate that measured nothing is a failure."""
    skipped = sum(result.status == "skipped" for result in results)
    counts = {
        "tests": str(len(results)),
        "failures": str(sum(result.is_bad for result in results)),
        "errors": "0",
        "skipped": str(skipped),
    }
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {"name": "bodycheck gate", **counts})
    for index, result in enumerate(results):
        name = f"gate[{index}] {result.gate.title}"
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": xml_text(where), "name": xml_text(name)}
        )
        if result.status == "skipped":
            ElementTree.SubElement(case, "skipped", {"message": xml_text(result.why)})
        if result.is_bad:
            failure = ElementTree.SubElement(
                case, "failure", {"type": result.status, "message": xml_text(line_of(result))}
            )
            lines = [" | ".join(filter(None, cells[1:])) for cells in failure_rows([result])]
            lines += error_lines(result)
            failure.text = xml_text("\n".join([result.gate.reason, *lines]))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def results_data(results: Sequence[GateResult], where: str, run_id: str) -> dict[str, Any]:
    """Return the file, the run, whether all gates passed, and each gate with all its rows."""
    return {
        "file": where,
        "run_id": run_id,
        "passed": not any(result.is_bad for result in results),
        "gates": [_gate(result) for result in results],
    }


def _gate(result: GateResult) -> dict[str, Any]:
    return {
        "gate": result.gate.model_dump(exclude_none=True),
        "status": result.status,
        "why": result.why,
        "left_out": result.left_out,
        "rows": [
            {**vars(check.row), "passed": check.passed, **_beyond(check, result)} for check in result.checks
        ],
    }


def _beyond(check: GateCheck, result: GateResult) -> dict[str, float | None]:
    """Return the distance under a key that names its unit; None if there is none or a side is 0."""
    finite = check.beyond is not None and math.isfinite(check.beyond)
    name = "beyond_decades" if result.gate.target.in_decades else "beyond"
    return {name: check.beyond if finite else None}


_COLUMNS = (
    Column("gate", "number"),
    Column("scenario", "name"),
    Column("method", "name"),
    Column("at", "fixed"),
    Column("obtained"),
    Column("bound"),
    Column("distance"),
    Column("command", "command"),
)
_TINTS = {"passed": "good", "failed": "bad", "nothing": "bad", "skipped": "none"}


def line_of(result: GateResult) -> str:
    """Return the result of a gate without its status: its title and its worst row."""
    cases = count(len(result.checks), "case")
    if result.status in ("nothing", "skipped"):
        return f"{result.gate.title}: {result.why}"
    if result.status == "failed":
        return f"{result.gate.title}: {len(result.failed)} of {cases} failed; {_worst(result)}"
    beside = "".join(f"; {reason}" for reason in result.left_out)
    return f"{result.gate.title}: {cases}; {_worst(result)}{beside}"


def _worst(result: GateResult) -> str:
    worst = result.worst
    assert worst is not None
    distance_text = distance(worst, result.gate)
    shown = obtained(worst) if worst.row.obtained is None else f"worst {obtained(worst)}"
    return shown + (f", {distance_text}" if distance_text else "")


def obtained(check: GateCheck) -> str:
    """Return the obtained value as text, or why there is none."""
    value = check.row.obtained
    if value is None:
        return check.row.why
    if not isinstance(value, str):
        return number(value)
    return f"{value}: {check.row.about}" if check.row.about else value


def note_failures(run: Tables, results: Iterable[GateResult]) -> None:
    """Add the results that are bad, and the cases that failed, to the manifest of a run."""
    for result in results:
        if result.is_bad:
            run.manifest.setdefault(FAILED_CHECKS, []).append(line_of(result))
            cases = (_case_of(check.row, run) for check in result.failed)
            run.manifest.setdefault(FAILED_CASES, []).extend(filter(None, cases))


def _case_of(row: GateRow, run: Tables) -> str:
    """Return SCENARIO,ENGINE:METHOD[,STEP], as `explain --case` takes it; "" without a case."""
    own = [case for case in run.cases if study_key(case.columns) == study_key(vars(row))]
    at = [case.setting.fineness for case in own if row.at and row.at == at_of(case.columns)]
    return failed_case(row.scenario, row.engine, row.method, *at) if own else ""


def failure_rows(results: Sequence[GateResult]) -> list[tuple[str, ...]]:
    """Return the cells of every row that failed, one per head of the printed table."""
    return [
        (
            f"[{index}]",
            check.row.scenario,
            f"{check.row.engine}:{check.row.method}",
            check.row.at,
            obtained(check),
            f"{result.gate.measure} {result.gate.bound}",
            distance(check, result.gate),
            check.row.reproduce,
        )
        for index, result in enumerate(results)
        for check in result.failed
    ]


def error_lines(result: GateResult) -> list[str]:
    """Return, for each row whose order failed, its error at each step."""
    return [
        f"{check.row.scenario} {check.row.engine}:{check.row.method}: {line}"
        for check in result.failed
        for line in check.row.errors
    ]


def results_document(results: Sequence[GateResult]) -> Document:
    """Return the counts, one line per gate, a table of the failed rows, and the reasons."""
    lines = tuple(
        (Span(result.status, _TINTS[result.status]), f"[{index}]", line_of(result))
        for index, result in enumerate(results)
    )
    reasons = (
        Sentence(line)
        for index, result in enumerate(results)
        if result.is_bad
        for line in (f"[{index}] {result.gate.reason}", *error_lines(result))
    )
    return Document(
        "bodycheck gate",
        (
            Sentence(f"{count(len(results), 'gate')}: {_counts(results)}", strong=True),
            Table((Column("", "fixed"), Column("", "number"), Column("")), lines),
            Table(_COLUMNS, tuple(failure_rows(results)), "Failed"),
            *reasons,
        ),
    )


_ENDINGS = {"passed": "passed", "failed": "failed", "nothing": "measured nothing", "skipped": "skipped"}


def _counts(results: Sequence[GateResult]) -> str:
    ended = Counter[str](result.status for result in results)
    return ", ".join(f"{ended[status]} {word}" for status, word in _ENDINGS.items() if ended[status])


def alerts_of(results: Sequence[GateResult], run: Tables, file: Path, lines: Sequence[int]) -> list[Alert]:
    """Return the gates that do not pass, each with the line of its table; lines: of all tables."""
    causes = {study_key(row): row["diagnosis"] for row in run.rows("diagnoses")}
    return [
        Alert(
            "gate-failed" if result.status == "failed" else "gate-measured-nothing",
            "\n".join(_alert_lines(result, causes)),
            file=file,
            line=line,
        )
        for result, line in zip(results, lines, strict=True)
        if result.is_bad
    ]


def _alert_lines(result: GateResult, causes: Mapping[StudyKey, str]) -> Iterator[str]:
    """Yield the worst case with value and bound, its cause, the reason of the bound, how to see it again."""
    worst = result.worst
    if worst is None:
        yield line_of(result)
    else:
        row = worst.row
        case = " ".join(filter(None, (row.scenario, f"{row.engine}:{row.method}", row.at)))
        beyond = f" ({distance_text})" if (distance_text := distance(worst, result.gate)) else ""
        others = len(result.failed) - 1
        more = f"; {count(others, 'more case')}" if others else ""
        yield f"{case}: {result.gate.measure} {obtained(worst)}, not {result.gate.bound}{beyond}{more}"
        if cause := causes.get(study_key(vars(row))):
            yield f"diagnosis: {cause}"
    yield f"reason of the bound: {result.gate.reason}"
    if worst is not None:
        yield f"reproduce: {worst.row.reproduce}"


def badge_of(results: Sequence[GateResult]) -> str:
    """Return how many gates pass, as a badge."""
    checked = [result for result in results if result.status != "skipped"]
    bad = sum(result.is_bad for result in checked)
    gates = count(len(checked), "gate")
    return badge(f"{bad} of {gates} failed" if bad else f"{gates} passed", good=not bad)


def changes_document(
    changes: Sequence[BoundChange], results: Sequence[GateResult], margin: float
) -> Document:
    """Return the replaced bounds, each with the measured value and the margin to it."""
    lines = []
    for change in changes:
        gate = results[change.index].gate
        lines.append(
            f"[{change.index}] {gate.scenario} {gate.engine}:{gate.method} {gate.measure}: {change.key} "
            f"{number(change.old)} -> {number(change.new)}; measured {number(change.measured)}"
            + ("" if change.key == "near" else f", margin {number(margin)} decades")
            + ("; loosened" if change.loosens else "")
        )
    loosened = {change.index for change in changes if change.loosens}
    left = sum(result.is_bad and index not in loosened for index, result in enumerate(results))
    if left:
        lines.append(f"{count(left, 'gate')} that did not pass left unchanged: loosen with --loosen REASON")
    lines.append(f"{count(len(changes), 'bound')} replaced")
    return Document("bodycheck gate --update", tuple(Sentence(line) for line in lines))
