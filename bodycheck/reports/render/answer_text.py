"""Print advice, and the results of a search through releases, as plain text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rich.text import Text

from bodycheck._util.formatting import console, count, names, number, print_columns, step
from bodycheck.reports.comparison.measure_track import Finding
from bodycheck.reports.summary.advice import Answer, Option


def print_advice(answers: Sequence[Answer], error: float, quantity: str, where: str) -> None:
    """Print the cheapest setting of each engine that meets the error tolerance; without one, the nearest."""
    out = console()
    out.print(Text(f"{quantity} <= {number(error)}, measured in {where}"))
    for answer in answers:
        out.print(Text(f"\n{_name(answer, len(answers) - 1)}", style="bold"))
        if answer.options:
            rows = [_row(option) for option in answer.options]
            heads = ("engine:method", "setting", "error at most", "cpu_s", "reproduce")
            print_columns(out, heads, rows, right=heads[2:4])
            if answer.without:
                out.print(Text(f"no measured setting meets it in {names(answer.without)}", style="yellow"))
        else:
            for line in _nothing(answer):
                out.print(Text(line, style="yellow"))


def _name(answer: Answer, scenarios: int) -> str:
    return f"all {scenarios} scenarios" if answer.scenario is None else answer.scenario


def _row(option: Option) -> tuple[str, ...]:
    time = "not measured" if option.cpu_s is None else number(option.cpu_s, 3)
    method = f"{option.engine}:{option.method}"
    return method, _setting_text(option), number(option.error, 3), time, option.reproduce


def _setting_text(option: Option) -> str:
    """Return the step or tolerance; a range if scenarios need different ones."""
    known = sorted({setting for setting in option.settings if setting is not None})
    if not known:
        return "no steps"
    word, unit = ("dt ", " s") if option.control == "dt" else ("tolerance ", "")
    return f"{word}{' to '.join(step(value) for value in dict.fromkeys((known[0], known[-1])))}{unit}"


def _nothing(answer: Answer) -> Iterator[str]:
    one = answer.nearest
    if one is None:
        yield "nothing was measured" if answer.scenario else "no method was measured on all scenarios"
        return
    yield (
        f"no measured setting meets it; the nearest is {one.engine}:{one.method}, {_setting_text(one)}: "
        f"{number(one.error, 3)}"
    )
    yield f"    {one.reproduce}"


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


def print_found(found: Found) -> None:
    """Print the releases that were run, oldest first, the failed ones, and one line per method."""
    out = console()
    texts = {track.method: _texts(found, track) for track in found.tracks}
    run = [version for version in found.versions if any(version in known for known in texts.values())]
    amounts = f"{count(len(found.versions), 'release')} from {found.versions[0]} to {found.versions[-1]}"
    out.print(Text(f"{found.measure} on {found.scenario}; {amounts}, {len(run)} of them run"))
    rows = ((version, *(known.get(version, "") for known in texts.values())) for version in run)
    print_columns(out, (found.engine, *texts), rows)
    for version, why in found.failed.items():
        out.print(Text(f"not run: {version}: {why}"), soft_wrap=True)
    for track in found.tracks:
        told = sentence(found, track, texts[track.method])
        out.print(Text(f"{found.engine}:{track.method}: {told}"), soft_wrap=True)
    if found.every:
        out.print(Text(_changed_in(found)), soft_wrap=True)


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
    befores, afters = zip(*track.changes, strict=True)
    parts = [f"{texts[run[0]]} up to {befores[0]}"]
    parts += [
        f"{texts[start]} from {start} to {end}" for start, end in zip(afters, befores[1:], strict=False)
    ]
    parts.append(f"{texts[afters[-1]]} from {afters[-1]}")
    return "; ".join([", ".join(parts), *_left_open(found, track)])


def _changed_in(found: Found) -> str:
    """Return the releases in which any method changed, with these methods."""
    changed = {
        version: [track.method for track in found.tracks if version in (after for _, after in track.changes)]
        for version in found.versions
    }
    told = [f"{version} ({', '.join(methods)})" for version, methods in changed.items() if methods]
    return f"changed in {', '.join(told)}" if told else "changed in no release"


def _left_open(found: Found, track: Track) -> list[str]:
    """Return which releases between two that differ could not be run; empty if there are none."""
    places = {version: place for place, version in enumerate(found.versions)}
    unknown = [
        version
        for before, after in track.changes
        for version in found.versions[places[before] + 1 : places[after]]
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
