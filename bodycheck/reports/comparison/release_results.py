"""The result of a search through releases, and its report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bodycheck._util.formatting import count, names, number
from bodycheck.reports.comparison.measure_track import Finding
from bodycheck.reports.document import Column, Document, Sentence, Table

_FEWEST_DIGITS, _ALL_DIGITS = 3, 17


@dataclass(frozen=True, eq=False)
class Track:
    """One method across releases: the findings of those that were run, and the changes between them."""

    method: str
    findings: Mapping[str, Finding]
    changes: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class Found:
    """The result of a search through releases.

    versions: all releases, oldest first. failed: release -> reason. every: whether every release was run.
    """

    engine: str
    scenario: str
    measure: str
    versions: tuple[str, ...]
    tracks: tuple[Track, ...]
    failed: Mapping[str, str]
    every: bool = False


def found_document(found: Found) -> Document:
    """Return the releases that were run, oldest first, the failed ones, and one line per method."""
    texts = {track.method: _texts(found, track) for track in found.tracks}
    run = [version for version in found.versions if any(version in known for known in texts.values())]
    amounts = f"{count(len(found.versions), 'release')} from {found.versions[0]} to {found.versions[-1]}"
    columns = tuple(Column(head, "fixed") for head in (found.engine, *texts))
    rows = tuple((version, *(known.get(version, "") for known in texts.values())) for version in run)
    sentences = [
        *(f"not run: {version}: {why}" for version, why in found.failed.items()),
        *found_sentences(found),
    ]
    first = Sentence(f"{found.measure} on {found.scenario}; {amounts}, {len(run)} of them run")
    return Document(
        f"bodycheck: releases of {found.engine}",
        (first, Table(columns, rows), *(Sentence(text) for text in sentences)),
    )


def found_data(found: Found) -> dict[str, Any]:
    """Return the search as data: its findings, changes and sentences."""
    return {**vars(found), "sentences": found_sentences(found)}


def found_sentences(found: Found) -> list[str]:
    """Return where each method changed, and where every release was run, those with a change."""
    lines = [
        f"{found.engine}:{track.method}: {sentence(found, track, _texts(found, track))}"
        for track in found.tracks
    ]
    return [*lines, _changed_in(found)] if found.every else lines


def sentence(found: Found, track: Track, texts: Mapping[str, str]) -> str:
    """Return where the measure of a method changed, as "2.00 up to 3.17.0, 4.00 from 4.0.0"."""
    run = [version for version in found.versions if version in texts]
    if not track.changes:
        if len(run) == 1:
            return f"{texts[run[0]]} in {run[0]}, the only release run"
        if found.every:
            return f"{texts[run[-1]]} in all {len(run)} releases run"
        same = f"{texts[run[-1]]} in {run[-1]}, as in {run[0]}"
        return f"{same}; a change that was undone between them would be missed"
    before, after = zip(*track.changes, strict=True)
    parts = [f"{texts[run[0]]} up to {before[0]}"]
    parts += [f"{texts[start]} from {start} to {end}" for start, end in zip(after, before[1:], strict=False)]
    parts.append(f"{texts[after[-1]]} from {after[-1]}")
    return "; ".join([", ".join(parts), *_unresolved(found, track)])


def _changed_in(found: Found) -> str:
    """Return the releases in which any method changed, with these methods."""
    changed = {
        version: [track.method for track in found.tracks if version in (after for _, after in track.changes)]
        for version in found.versions
    }
    parts = [f"{version} ({', '.join(methods)})" for version, methods in changed.items() if methods]
    return f"changed in {', '.join(parts)}" if parts else "changed in no release"


def _unresolved(found: Found, track: Track) -> list[str]:
    """Return which releases between two that differ could not be run; empty if there are none."""
    indices = {version: index for index, version in enumerate(found.versions)}
    unknown = [
        version
        for before, after in track.changes
        for version in found.versions[indices[before] + 1 : indices[after]]
    ]
    return [f"{names(unknown)} between them could not be run"] if unknown else []


def _texts(found: Found, track: Track) -> dict[str, str]:
    """Return the value of each release, with as many digits as distinguish both sides of each change."""
    for digits in range(_FEWEST_DIGITS, _ALL_DIGITS + 1):
        texts = {
            version: _text(finding, digits, is_order=found.measure.startswith("order."))
            for version, finding in track.findings.items()
        }
        if all(texts[before] != texts[after] for before, after in track.changes):
            break
    return texts


def _text(finding: Finding, digits: int, *, is_order: bool) -> str:
    if finding.value is None:
        return f"none ({finding.why})"
    if isinstance(finding.value, str):
        return finding.value
    return f"{finding.value:.{digits - 1}f}" if is_order else number(finding.value, digits)
