"""The answer of an audit in sentences: first the file, then each importer."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from bodycheck._util.formatting import count, names, number
from bodycheck.audit.audit import ALONE, Audit, ImporterColumn, JointAudit, LinkAudit, LintFinding, Severity
from bodycheck.reports.document import Sentence

LEVELS: tuple[Severity, ...] = ("error", "warning", "note")
TINTS = {"error": "bad", "warning": "open", "note": "none"}
IMPOSSIBLE = ("unreadable", "negative-mass", "zero-mass", "not-positive", "triangle-inequality")
"""The rules whose errors mean that no body has the numbers of a link, the worst first."""

_DISCARDED = "tensor discarded"
_NAMES = {"mujoco": "MuJoCo", "pybullet": "PyBullet", "dart": "DART"}
_MAX_MESSAGE = 120
_MOST = 0.6  # of the links of an importer: what it does to so many is said once
_OUTPUT = re.compile(r"; its last output: .*", re.DOTALL)
_EXCEPTION = re.compile(r"^(?:\w*[Ee]rror: )+")


def by_severity(findings: Sequence[LintFinding]) -> list[LintFinding]:
    """Return findings from errors to notes, each from the worst and most certain numbers."""
    ranks = {rule: rank for rank, rule in enumerate(IMPOSSIBLE)}
    ranks["missing-moment"] = ranks["not-positive"]  # which it makes of the same link, and which follows it

    def place(one: LintFinding) -> tuple[int, int, bool]:
        is_doubted = one.rule == "triangle-inequality" and one.confidence != "certain"  # by its last digits
        return LEVELS.index(one.severity), ranks.get(one.rule, len(ranks)), is_doubted

    return sorted(findings, key=place)


def answer(audit: Audit) -> list[Sentence]:
    """Return a sentence about the file, and one about each importer; of two files, how they compare first."""
    clauses = {column.name: _clause(audit, column) for column in audit.columns}
    about, importers = _of_file(audit, clauses), _of_importers(audit, clauses)
    if not audit.compared:
        return [about, *importers]
    compared = [replace(one, strong=True, tint="bad" if one.tint == "bad" else "good") for one in importers]
    return [*compared, replace(about, strong=False)]


def _of_file(audit: Audit, clauses: Mapping[str, tuple[str, bool]]) -> Sentence:
    findings = by_severity(audit.findings)
    amounts = Counter(one.severity for one in findings)
    counted = ", ".join(count(amounts[level], level) for level in LEVELS if amounts[level])
    file, links = Path(audit.compared or audit.file).name, count(len(audit.links), "link")
    if not findings or findings[0].severity == "note":
        problems = f"{counted}, no error or warning" if findings else "no problem found in the file"
        imports, changed = _changed(audit, clauses)
        noted = f" {_where(findings[0])}." if findings else ""
        tint = "open" if changed else "good"
        return Sentence(f"{file}: {problems} ({links}){imports}.{noted}", tint, strong=True)
    first = findings[0]
    where = _where(first)
    more = f" (and {len(findings) - 1} more below)" if len(findings) > 1 else ""
    return Sentence(f"{file}: {counted}: {where}{more}", TINTS[first.severity], strong=True)


def _where(finding: LintFinding) -> str:
    return f"{finding.link}, line {finding.line}: {finding.message.partition('; ')[0]}"


def _changed(audit: Audit, clauses: Mapping[str, tuple[str, bool]]) -> tuple[str, bool]:
    """Return which imports of a file change or refuse it, as the end of a sentence, and whether any does."""
    read = [one.name for one in audit.columns if one.outcome != "unsupported" and not audit.compared]
    wrong = [name for name in read if not clauses[name][1] or _merges_all(audit, name)]
    if not wrong:
        return "; every import holds it" * bool(read), False
    refused = set(audit.failed)
    verbs = ["change"] * (not refused.issuperset(wrong)) + ["refuse"] * bool(refused)
    if len(wrong) == 1:
        verbs = [f"{verb}s" for verb in verbs]
    return f"; {len(wrong)} of {count(len(read), 'import')} {' or '.join(verbs)} it: {names(wrong)}", True


def _merges_all(audit: Audit, name: str) -> bool:
    """Return whether no link is left that moves."""
    return {link.held[name].state for link in audit.links if name in link.held} == {"merged"}


def _of_importers(audit: Audit, every: Mapping[str, tuple[str, bool]]) -> list[Sentence]:
    found = []
    for engine, columns in groupby(audit.columns, key=lambda one: one.engine):
        clauses = {column.flags: every[column.name] for column in columns}
        name, _, version = engine.partition("==")
        name = " ".join(filter(None, (_NAMES.get(name, name), version)))
        sound = all(good for _, good in clauses.values())
        texts = [text for text, _ in clauses.values()]
        if len(set(texts)) == 1:
            sentence = f"{name} {texts[0]}"
        else:
            parts = [f"{flags} {text}" for flags, (text, _) in clauses.items()]
            sentence = f"{name}'s {'; '.join(parts)}"
        found.append(Sentence(f"{sentence}.", "none" if sound else "bad"))
    return found


def _clause(audit: Audit, column: ImporterColumn) -> tuple[str, bool]:
    """Return what an importer does with the file, and whether it holds all that it reads."""
    bodies, sound = _of_bodies(audit, column)
    changed = [group for group in joint_groups(audit) if group.importer == column.name]
    joints = {joint for group in changed for joint in group.joints}
    matrix = audit.matrices.get(column.name)
    if matrix is not None and matrix.is_wrong and not joints:
        return f"{bodies}{', but' if sound else ', and'} its mass matrix differs ({matrix.cause})", False
    if column.outcome != "ok" or not joints:
        return bodies, sound
    first = max(changed, key=lambda group: len(group.joints))
    amount = f"{len(joints)} of {count(len(moving_joints(audit)), 'joint')}"
    return f"{bodies}{', but changes' if sound else ', and'} {amount} ({first.kind})", False


def moving_joints(audit: Audit) -> list[JointAudit]:
    """Return the joints that are not fixed in the file."""
    return [joint for joint in audit.joints if joint.stated.motion != "fixed"]


@dataclass(frozen=True)
class JointGroup:
    """A kind of difference in one importer: the joints that have it, and its text in the first of them."""

    importer: str
    kind: str
    joints: tuple[str, ...]
    first: str
    same: bool


def joint_groups(audit: Audit) -> list[JointGroup]:
    """Return the differences of joints by importer and kind, in the order of importers."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for joint, importer, cause in audit.differing_joints():
        found.setdefault((importer, cause.partition(":")[0]), {})[joint.name] = cause
    order = [column.name for column in audit.columns]
    groups = [
        JointGroup(importer, kind, tuple(causes), next(iter(causes.values())), len(set(causes.values())) == 1)
        for (importer, kind), causes in found.items()
    ]
    return sorted(groups, key=lambda group: order.index(group.importer))


def _of_bodies(audit: Audit, column: ImporterColumn) -> tuple[str, bool]:
    """Return what an importer does with the bodies of the file, and whether it holds all that it reads."""
    if column.outcome == "unsupported":
        return column.message, True
    if column.outcome != "ok":
        why = _EXCEPTION.sub("", _OUTPUT.sub("", column.message)).strip()
        verb = {"failed": "refuses it", "timeout": "does not end in time"}.get(column.outcome, column.outcome)
        return f"{verb} ({why[:_MAX_MESSAGE]})" if why else verb, False
    links = [link for link in audit.links if column.name in link.held]
    every = [link.held[column.name] for link in links]
    states = Counter(one.state for one in every)
    total, merged = sum(states.values()), states["merged"]
    differing = [why for _, name, why in audit.differing() if name == column.name]
    changing = [why for why in differing if why != ALONE]
    turning = len(differing) - len(changing)
    turns = f", and turns {count(turning, 'link')} otherwise, as by damping" if turning else ""
    if (which := said_once(audit).get(column.name)) is not None:
        changed = len(changing) - len(_discarding(audit, column.name))
        more = f", and changes {count(changed, 'link')} otherwise" if changed else ""
        spins = [link.spins[column.name] for link in audit.links if column.name in link.spins]
        off = max((one.held_rad or 0.0 for one in spins if one.follows(one.held_rad) is False), default=0.0)
        spun = "a free spin of a possible link" if impossible(audit) else "a free spin"
        turned = f", so that {spun} is up to {number(off, 2)} rad off after 1 s" if off else ""
        return f"discards {which}{turned}{more}{turns}", False
    if audit.compared:
        return _compared(audit, len(differing), total, single=bool(states["rounded"]))
    if changing:
        causes = Counter(why.partition(":")[0].partition(" (")[0] for why in changing)
        parts = (cause if len(causes) == 1 else f"{cause}: {n}" for cause, n in causes.most_common())
        return f"changes {len(changing)} of {count(total, 'link')} ({'; '.join(parts)}){turns}", False
    if turning:
        return f"turns {turning} of {count(total, 'link')} otherwise, as by damping", False
    if not total:
        return "reads it", True
    if _merges_all(audit, column.name):
        return "merges every link into the world", True
    held = "to single precision" if states["rounded"] else "as written"
    into_world = sum(one.into == "the world" for one in every)
    within = f", with {count(merged - into_world, 'link')} merged" if merged > into_world else ""
    fixes = "merges the base into the world" if into_world else "fixes the base to the world"
    base = f", but {fixes}" if any(one.fixed for one in every) else ""
    wrong = {finding.link for finding in impossible(audit)}
    compared = {link.name for link in links if link.held[column.name].state != "not computed"}
    numbers = "the impossible numbers" if wrong & compared else "the other links" if wrong else "it"
    if not wrong and any(finding.rule == "zero-axis" for finding in audit.findings):
        numbers = "the links"  # no importer is compared with an axis that is none
    return f"holds {numbers} {held}{within}{base}", True


def _compared(audit: Audit, differing: int, total: int, *, single: bool) -> tuple[str, bool]:
    """Return whether a file states the bodies of another."""
    other = Path(audit.file).name
    if differing:
        return f"states {differing} of {count(total, 'link')} otherwise than {other}", False
    return f"states the bodies of {other}" + (", to single precision" if single else ""), True


def said_once(audit: Audit) -> dict[str, str]:
    """Return importer -> which tensors it discards, where these are most of those that it holds."""
    found = {}
    for column in audit.columns:
        discarding = len(_discarding(audit, column.name))
        held = sum(
            one.state not in ("merged", "absent", "not computed")
            and one.expected is not None
            and one.expected.mass_kg > 0.0
            for link in audit.links
            if (one := link.held.get(column.name)) is not None
        )
        if discarding and discarding >= held:
            found[column.name] = "every tensor"
        elif discarding > _MOST * held:
            # the others may have been recomputed to the same numbers
            found[column.name] = f"tensors, which changes {discarding} of {count(held, 'link')}"
    return found


def _discarding(audit: Audit, name: str) -> list[LinkAudit]:
    """Return the links whose only difference is a tensor that the importer discards."""
    return [
        link
        for link in audit.links
        if (one := link.held.get(name)) is not None
        and one.state == "differs"
        and one.causes
        and all(cause.startswith(_DISCARDED) for cause in one.causes)
    ]


def repeated(audit: Audit) -> set[tuple[str, str]]:
    """Return (link, importer) of each difference that the sentence on the importer states of every link."""
    return {(link.name, name) for name in said_once(audit) for link in _discarding(audit, name)}


def impossible(audit: Audit) -> list[LintFinding]:
    """Return the findings of numbers that no body has."""
    return [one for one in audit.findings if one.severity == "error" and one.rule in IMPOSSIBLE]
