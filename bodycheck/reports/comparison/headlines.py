"""One line per changed method: what became worse or better, by which factor, and why; the most severe first.

Consoles, Markdown, pages, feeds and annotations show these lines as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from bodycheck._util.formatting import count, names, number, setting
from bodycheck._util.source_commit import commit_range
from bodycheck.reports.comparison.change import FAILING, MAP_KINDS, Change, Kind
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.verdicts import STATES, UNDECIDED, severity
from bodycheck.reports.run_files.method_words import map_in_words
from bodycheck.reports.run_files.run_tables import StudyKey, Tables, study_key

Direction: TypeAlias = Literal["worse", "improved", "moved"]

_MAX_LINES = 6
_FARTHER_DECADES = 1.0  # a measure that changed by this much more than the orientation is named as well
_SAME_FACTOR = 1e-3
_DIGITS_BELOW = 1e-3  # a smaller relative change is reported as a digit, a larger one in percent
NO_KNOWN_CAUSE = "no known fault explains it"
BROKEN: tuple[Kind, ...] = ("case", "outcome", "verdict")
"""The kinds of a failing change that make the method's improvements worthless."""


@dataclass(frozen=True)
class Headline:
    """The changes of one direction of a method, or of methods of an engine with one cause.

    cause: the diagnosis. release: "before -> after" of the engine's version, else "before..after" of commits.
    """

    engine: str
    methods: tuple[str, ...]
    direction: Direction
    changes: tuple[Change, ...]
    cause: str = ""
    release: str = ""

    @property
    def weight(self) -> tuple[bool, float]:
        """The sort key, the most severe last: changes without a size outweigh any factor."""
        sizes = [abs(one.decades) for one in self.changes if one.decades is not None]
        return any(one.kind in BROKEN for one in self.changes), max(sizes, default=0.0)

    @property
    def subject(self) -> str:
        """Engine and methods."""
        return _subject(self.engine, self.methods)

    @property
    def main(self) -> Change:
        """The change whose scenario the text names first: the largest of an error."""
        return main_of(self.changes)

    @property
    def text(self) -> str:
        """Return "mujoco:rk4: order 4 -> 2 in orientation, error at dt 0.001 s x 7e5 in brick (cause)"."""
        engine, arrow, version = self.release.rpartition(" -> ")
        since = f"since version {version}, {engine} before" if arrow else ""
        commits = f"in commits {version}" if version and not arrow else ""
        why = "; ".join(filter(None, (self.cause, since, commits)))
        return self._with(", ".join(self._effects)) + (f" ({why})" if why else "")

    @property
    def title(self) -> str:
        """Return the first effect alone, "mujoco:rk4: order 4 -> 2 in orientation in brick"."""
        return self._with(", ".join(self._effects[:1]))

    @property
    def _effects(self) -> list[str]:
        return [part for make in _EFFECTS for part in make(self.changes, self.direction)]

    def _with(self, effects: str) -> str:
        improved = " improved" if self.direction == "improved" else ""
        return f"{self.subject}{improved}: {effects}{self.where}"

    @property
    def where(self) -> str:
        """Return " in brick and 2 more scenarios", or "" for what holds in all of them."""
        first = [self.main.scenario] if self.main.scenario else []
        scenarios = dict.fromkeys([*first, *(one.scenario for one in self.changes if one.scenario)])
        return f" in {names_of(list(scenarios))}" if scenarios else ""


def main_of(changes: Sequence[Change]) -> Change:
    """Return the change whose scenario a text names first: the largest of an error."""
    return largest_error(changes) or changes[0]


def is_known(cause: str) -> bool:
    """Return whether a cause is known, which several methods may share."""
    return cause not in ("", NO_KNOWN_CAUSE)


def _subject(engine: str, methods: Sequence[str]) -> str:
    return f"{engine}:{methods[0]}" if len(methods) == 1 else f"{engine}: {names(methods)}"


def names_of(scenarios: Sequence[str]) -> str:
    """Return "brick", or "brick and 2 more scenarios"."""
    first, *others = scenarios
    return first + (f" and {count(len(others), 'more scenario')}" if others else "")


def lines_of(comparison: Comparison) -> list[Headline]:
    """Return the lines of a comparison: what is worse or missing, what improved, what is another map.

    Improvements of a method that no longer converges or ends well do not count.
    """
    causes = new_causes(comparison.before, comparison.after)
    changed = releases(comparison.before, comparison.after)
    by_method: dict[tuple[str, str], list[Change]] = {}
    for change in comparison.changes:
        by_method.setdefault((change.engine, change.method), []).append(change)
    found = []
    for (engine, method), changes in by_method.items():
        failing = [one for one in changes if one.status in FAILING]
        better = [one for one in changes if one.status == "improved"]
        identity = [one for one in changes if one.kind in MAP_KINDS]
        broken = any(one.kind in BROKEN for one in failing)
        directions: list[tuple[Direction, list[Change]]] = [
            ("worse", failing),
            ("improved", [] if broken else better),
        ]
        for direction, own in directions:
            if own:
                diagnosed = [(one, causes.get((one.scenario or "", engine, method), "")) for one in own]
                cause = cause_of(diagnosed) if direction == "worse" else ""
                own, identity = [*own, *identity], []
                found.append(
                    Headline(engine, (method,), direction, tuple(own), cause, changed.get(engine, ""))
                )
        if identity:
            found.append(
                Headline(engine, (method,), "moved", tuple(identity), release=changed.get(engine, ""))
            )
    return by_weight(found)


def by_weight(lines: Iterable[Headline]) -> list[Headline]:
    """Return lines with the same cause as one, and those of an engine's missing methods; what is worse first.

    Then by weight.
    """
    merged: dict[tuple[str, ...], list[Headline]] = {}
    for one in lines:
        gone = all((change.kind, change.status) == ("case", "missing") for change in one.changes)
        own = ("missing",) if gone else () if is_known(one.cause) else one.methods
        merged.setdefault((one.direction, one.engine, one.cause, *own), []).append(one)
    found = [
        Headline(
            some[0].engine,
            tuple(dict.fromkeys(method for one in some for method in one.methods)),
            some[0].direction,
            tuple(sorted((change for one in some for change in one.changes), key=lambda c: -c.size)),
            some[0].cause,
            some[0].release,
        )
        for some in merged.values()
    ]
    heaviest = sorted(found, key=lambda one: one.weight, reverse=True)
    return sorted(heaviest, key=lambda one: ("worse", "improved", "moved").index(one.direction))


def headlines(lines: Sequence[Headline]) -> list[str]:
    """Return the texts of the most severe lines of each direction, and how many more there are."""
    found = []
    for direction in ("worse", "improved", "moved"):
        own = [one for one in lines if one.direction == direction]
        found += [f"{one.text}." for one in own[:_MAX_LINES]]
        if rest := own[_MAX_LINES:]:
            found.append(f"{count(len(rest), 'more method')} {direction}.")
    return found


def moved_texts(comparison: Comparison, lines: Iterable[Headline]) -> list[str]:
    """Return "mujoco: euler and rk4 moved by up to 1.2 %", one text per engine.

    lines: those that name their methods already.
    """
    named = {(line.engine, method) for line in lines for method in line.methods}
    by_engine: dict[str, list[Change]] = {}
    for change in comparison.of_status("moved"):
        if (change.engine, change.method) not in named:
            by_engine.setdefault(change.engine, []).append(change)
    return [
        f"{_subject(engine, list(dict.fromkeys(one.method for one in moved)))} moved"
        f"{moved_text(moved, comparison.thresholds)}"
        for engine, moved in by_engine.items()
    ]


def causes_of(tables: Tables) -> dict[StudyKey, str]:
    """Return the diagnosis of each method on each scenario that has one."""
    found = {
        study_key(row): NO_KNOWN_CAUSE if row["verdict"] == "unexplained" else row["diagnosis"]
        for row in tables.rows("diagnoses")
        if "faults" in row or row["verdict"] in ("lower-order", "unexplained")
    }
    return {key: text.replace(" (explains", ", explains").removesuffix(")") for key, text in found.items()}


def new_causes(before: Tables, after: Tables) -> dict[StudyKey, str]:
    """Return the diagnosis of each method on each scenario that has another one than before."""
    old = causes_of(before)
    return {key: text for key, text in causes_of(after).items() if old.get(key) != text}


def cause_of(diagnosed: Sequence[tuple[Change, str]]) -> str:
    """Return the cause in the scenario that the text names first, or else in another; "" if none is known.

    The other is named where the cause in the first one was looked for in vain.
    """
    main = main_of([change for change, _ in diagnosed])
    first = sorted(diagnosed, key=lambda pair: pair[0].scenario != main.scenario)
    found = next((pair for pair in first if is_known(pair[1])), None)
    is_unexplained = any(cause == NO_KNOWN_CAUSE for _, cause in diagnosed)
    if found is None:
        return NO_KNOWN_CAUSE if is_unexplained else ""
    change, cause = found
    is_elsewhere = is_unexplained and change.scenario and change.scenario != main.scenario
    return f"{cause} in {change.scenario}" if is_elsewhere else cause


def releases(before: Tables, after: Tables) -> dict[str, str]:
    """Return "before -> after" of each engine whose version changed; else the commits, if they are known."""
    old, new = (
        {name: entry.get("version") for name, entry in tables.manifest["engines"].items()}
        for tables in (before, after)
    )
    commits = commit_range(before.manifest, after.manifest)
    found = dict.fromkeys(new, commits) if commits else {}
    return found | {
        name: f"{old[name]} -> {version}"
        for name, version in new.items()
        if version and old.get(name) and old[name] != version
    }


# --------------------------------------------------------------------------------- the effects, one per kind

_Effects: TypeAlias = Callable[[Sequence[Change], Direction], list[str]]


def _of_kind(changes: Iterable[Change], *kinds: Kind) -> list[Change]:
    return [one for one in changes if one.kind in kinds]


def _cases(changes: Sequence[Change], _: Direction) -> list[str]:
    missing = _of_kind(changes, "case")
    return [f"no longer measured ({count(len(missing), 'case')})"] if missing else []


def _outcomes(changes: Sequence[Change], _: Direction) -> list[str]:
    found = _of_kind(changes, "outcome")
    words = dict.fromkeys((one.before, one.after) for one in found)
    counts = {pair: sum((one.before, one.after) == pair for one in found) for pair in words}
    return [f"{after} in {count(n, 'case')} ({before} before)" for (before, after), n in counts.items()]


def _verdicts(changes: Sequence[Change], direction: Direction) -> list[str]:
    found = _of_kind(changes, "verdict")
    # an error says more than that its order is no longer known
    if direction == "worse" and largest_error(changes) is not None:
        decided = [one for one in found if severity(str(one.after)) != UNDECIDED]
        found = [one for one in found if one.quantity.endswith(ORIENTATION)] or decided
    if not found:
        return []
    one = next((c for c in found if c.quantity.endswith(ORIENTATION)), found[0])
    of_it = "" if one.quantity.endswith(ORIENTATION) else f" in {label(one.quantity)}"
    if one.after == "does-not-converge":
        return [f"no longer converges{of_it}"]
    before, after = (STATES[str(word)].word for word in (one.before, one.after))
    return [f"{'now ' * (direction == 'improved')}{after}{of_it} ({before} before)"]


def _orders(changes: Sequence[Change], _: Direction) -> list[str]:
    """Return the change of order in the orientation, or else that which matches the largest error.

    By quantity and, if possible, by scenario.
    """
    found, error = _of_kind(changes, "order"), largest_error(changes)
    if not found:
        return []
    if error is not None:
        found.sort(
            key=lambda one: (
                not one.quantity.endswith(ORIENTATION),
                label(one.quantity) != label(error.quantity),
                one.scenario != error.scenario,
            )
        )
    before, after = distinct(found[0], 2)
    return [f"order {before} -> {after} in {label(found[0].quantity)}"]


def _errors(changes: Sequence[Change], _: Direction) -> list[str]:
    sized = [one for one in _of_kind(changes, "accuracy") if one.decades is not None]
    gone = dict.fromkeys(one.quantity for one in _of_kind(changes, "accuracy") if one.after is None)
    largest = largest_error(changes)
    worst = max(sized, key=lambda one: one.size, default=None)
    named = [one for one in (largest,) if one is not None]
    if largest and worst and worst.size > largest.size + _FARTHER_DECADES:
        named.append(worst)
    texts = [
        f"{'error' if one.quantity == ORIENTATION else label(one.quantity)}{at(one)} {factor(one)}"
        f"{f' ({one.scenario})' if one.scenario != named[0].scenario else ''}"
        for one in named
    ]
    return texts + ([f"{names(list(map(label, gone)))} no longer measured"] if gone else [])


def _others(changes: Sequence[Change], _: Direction) -> list[str]:
    found = []
    for one in _of_kind(changes, "stability")[:1]:
        before, after = distinct(one, 2)
        found.append(f"{label(one.quantity)} {before} -> {after}")
    for one in _of_kind(changes, "speed")[:1]:
        slow = "slower" if (one.decades or 0.0) > 0.0 else "faster"
        found.append(f"{number(10.0**one.size, 3)} times {slow}")
    for one in _of_kind(changes, *MAP_KINDS):
        before, after = (map_in_words(str(label)) for label in (one.before, one.after))
        found.append(f"{one.quantity} {before} -> {after}")
    return found


_EFFECTS: tuple[_Effects, ...] = (_cases, _outcomes, _verdicts, _orders, _errors, _others)


def largest_error(changes: Iterable[Change]) -> Change | None:
    """Return the largest change of the orientation error, or else of any measure."""
    errors = [one for one in _of_kind(changes, "accuracy") if one.decades is not None]
    of_orientation = [one for one in errors if one.quantity == ORIENTATION]
    return max(of_orientation or errors, key=lambda one: one.size, default=None)


def _short(quantity: str) -> str:
    return "error" if quantity == ORIENTATION else label(quantity)


def label(quantity: str) -> str:
    """Return a quantity in words: "orientation", "energy drift", "largest stable step"."""
    pure = quantity.rpartition(" of ")[2].removesuffix("_abs")
    if pure == "dt_stable_s":
        return "largest stable step in s"
    return pure.removesuffix("_rad").removesuffix("_error").replace("_", " ")


def at(change: Change) -> str:
    """Return " at dt 0.001 s", " at tolerance 1e-6", or "" if the change is not of one case."""
    return "" if change.fineness is None else f" at {setting(change.control, change.fineness)}"


def factor(change: Change) -> str:
    """Return "x 1.9e6", or "+2.1 %" if a change is below 100 %; "" without a size.

    Of a value below its noise: "x 1.9e6 above its noise", and "x 5e-7, to its noise".
    """
    if change.decades is None or change.relative is None:
        return ""
    if change.relative >= 1.0:
        times = 10.0**change.decades
        of_noise = " above its noise" if times > 1.0 else ", to its noise"
        text = f"x {times:.0f}" if 10.0 <= times < 1e3 else f"x {number(times, 2)}"
        return text + of_noise * _is_of_noise(change)
    return f"{'+' if change.decades > 0.0 else '-'}{number(100.0 * change.relative, 2)} %"


def _is_of_noise(change: Change) -> bool:
    """Whether the smaller value is below its noise, which counts in its place."""
    values = [value for value in (change.before, change.after) if isinstance(value, float)]
    low, high = min(values, default=0.0), max(values, default=0.0)
    stated = low * 10.0 ** abs(change.decades or 0.0)
    return change.kind == "accuracy" and stated < high * (1.0 - _SAME_FACTOR)


def distinct(change: Change, least: int) -> tuple[str, str]:
    """Return both values with as many digits as distinguish them, at least `least`."""
    for digits in range(least, 18):
        texts = _value(change.before, digits), _value(change.after, digits)
        if texts[0] != texts[1]:
            break
    return texts


def _value(value: float | str | None, digits: int) -> str:
    if value is None:
        return "not measured"
    return value if isinstance(value, str) else number(value, digits)


def moved_text(changes: Iterable[Change], thresholds: Thresholds) -> str:
    """Return the largest size of the moved changes: " by up to 1.2 %", " in the 12th digit"; "" without one.

    A moved change larger than the threshold is within round-off, or random.
    """
    sizes = [(one.relative, thresholds.of(one.quantity)) for one in changes if one.relative is not None]
    below = [size for size, threshold in sizes if size <= threshold]
    if not sizes:
        return ""
    return _size_text(max(below)) if below else " within round-off"


def _size_text(relative: float) -> str:
    if relative >= _DIGITS_BELOW:
        return f" by up to {number(100.0 * relative, 2)} %"
    digit = math.floor(-math.log10(relative)) + 1
    ending = {1: "st", 2: "nd", 3: "rd"}.get(digit % 10 if digit not in (11, 12, 13) else 0, "th")
    return f" in the {digit}{ending} digit"
