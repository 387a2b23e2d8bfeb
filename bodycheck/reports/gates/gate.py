"""Read and validate a tolerance file: [[gate]] bounds of measures and [[change]] thresholds."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import Field, StrictStr, ValidationError, field_validator

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import nearest, number, step
from bodycheck._util.untrusted import parse_toml, read_text
from bodycheck.adapters.engine_names import is_command, split_method
from bodycheck.adapters.reading_names import READINGS
from bodycheck.adapters.registry import engine_names, requested_name
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.measurement.measures import MEASURES, QUANTITIES
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.run_files.method_words import LAW_NAMES
from bodycheck.scenarios.fields import NotNegative, Number, Positive, TomlTable
from bodycheck.scenarios.reader import fault_lines

Source: TypeAlias = Literal["results", "methods", "stability", "laws", "dynamics"]

_SPEEDS = ("cpu_s", "ns_per_step", "relative_cpu")
_COUNTS = ("steps", "rhs_evaluations")
UNCOMPARED = ("successive_difference_rad", "cpu_s", "ns_per_step", *_COUNTS)
"""Columns of results.csv that a gate can bound, but by which runs are not compared."""
_COLUMNS = (
    *(column for measure in MEASURES.values() for column in measure.columns),
    *("successive_difference_rad", *_SPEEDS, *_COUNTS),
)
_NOT_VERDICTS = ("failed", "timeout", "invalid", "unsupported", "inconsistent")
_VERDICTS = tuple(state for state in STATES if state not in _NOT_VERDICTS)
_OUTCOMES = ("ok", "unstable", "failed", "timeout", "unsupported", "invalid")
_GROWTHS = ("bounded", "sqrt", "linear", "quadratic", "exponential")


@dataclass(frozen=True)
class GateMeasure:
    """The table, the column and the quantity that a gate reads, and the words that may stand there.

    choices: empty if the values are numbers. in_decades: whether two values are compared by their ratio, as
    errors and times are, or by their difference, as orders are. is_speed: whether the value exists only where
    processor time was measured.
    """

    source: Source
    column: str
    quantity: str | None = None
    choices: tuple[str, ...] = ()
    in_decades: bool = True
    is_speed: bool = False


def measure_of(name: str) -> GateMeasure:
    """Return the measure of that name; raise ValueError with what it could be if there is none."""
    if name in _COLUMNS:
        return GateMeasure("results", name, in_decades=name not in _COUNTS, is_speed=name in _SPEEDS)
    head, _, quantity = name.partition(".")
    match head, quantity:
        case "outcome", "":
            return GateMeasure("results", "outcome", choices=_OUTCOMES)
        case "stability", "dt_stable_s":
            return GateMeasure("stability", "dt_stable_s")
        case "law", _ if quantity in LAW_NAMES:
            return GateMeasure("laws", "size", quantity)
        case "dynamics", _ if quantity in READINGS:
            return GateMeasure("dynamics", "worst", quantity)
        case "verdict", "":
            return GateMeasure("methods", "verdict", choices=_VERDICTS)
        case "verdict", _ if quantity in QUANTITIES:
            return GateMeasure("methods", "verdict", quantity, choices=_VERDICTS)
        case "growth", _ if quantity in QUANTITIES:
            return GateMeasure("methods", "growth", quantity, choices=_GROWTHS)
        case "order", _ if quantity in QUANTITIES:
            return GateMeasure("methods", "order", quantity, in_decades=False)
    if near := nearest(name, measure_names()):
        raise ValueError(f"unknown measure {name!r}; did you mean {near}?")
    raise ValueError(
        f"unknown measure {name!r} (available: the columns that bodycheck list measures shows, "
        f"{', '.join(_SPEEDS)}, outcome, verdict, stability.dt_stable_s, order., verdict. or growth. "
        f"followed by one of {', '.join(QUANTITIES)}, law. followed by one of {', '.join(LAW_NAMES)}, and "
        f"dynamics. followed by one of {', '.join(READINGS)})"
    )


def measure_names() -> list[str]:
    """Return every name that `measure_of` accepts."""
    heads = ("verdict", "growth", "order")
    of_methods = [f"{head}.{quantity}" for head in heads for quantity in QUANTITIES]
    laws = [f"law.{name}" for name in LAW_NAMES]
    dynamics = [f"dynamics.{reading}" for reading in READINGS]
    return [*_COLUMNS, "outcome", "verdict", "stability.dt_stable_s", *of_methods, *laws, *dynamics]


_Pattern = Annotated[StrictStr, Field(min_length=1)]
"""A name pattern: * matches any characters, ? any one character, [ab] one of these."""

_MAX_DECADES = 300.0  # 10^300 still fits in a double

_Made = TypeVar("_Made")

_BOUNDS = ("upper", "lower", "near", "equals")


class Gate(TomlTable):
    """One bound on one measure of all the cases that its patterns match.

    scenario matches the name of a scenario or of its family, engine and method match those names. dt_s (in s)
    or tolerance selects one step. upper and lower are inclusive; near and decades mean the interval from
    near x 10^-decades to near x 10^decades; equals is a word. Values and bounds below floor count as floor.
    """

    scenario: _Pattern = "*"
    engine: _Pattern = "*"
    method: _Pattern = "*"
    dt_s: Positive | None = None
    tolerance: Positive | None = None
    measure: StrictStr
    upper: Number | None = None
    lower: Number | None = None
    near: Positive | None = None
    decades: Annotated[Positive, Field(le=_MAX_DECADES)] | None = None
    equals: StrictStr | None = None
    floor: NotNegative | None = None
    reason: StrictStr

    @field_validator("measure")
    @classmethod
    def _is_known(cls, value: str) -> str:
        measure_of(value)
        return value

    @field_validator("reason")
    @classmethod
    def _is_not_blank(cls, value: str) -> str:
        if not value.strip():
            raise ValueError("must give the reason for this bound")
        return value

    @cached_property
    def target(self) -> GateMeasure:
        """The measure that the key `measure` names."""
        return measure_of(self.measure)

    @property
    def min_value(self) -> float | None:
        """The smallest value that passes; None if any small value does."""
        return self.lower if self.near is None else self.near / 10.0 ** (self.decades or 0.0)

    @property
    def max_value(self) -> float | None:
        """The largest value that passes; None if any large value does."""
        return self.upper if self.near is None else self.near * 10.0 ** (self.decades or 0.0)

    @property
    def bound(self) -> str:
        """The bound as text: "<= 1e-9", "within 0.1 decades of 1.4e-2", "= converges"."""
        if self.equals is not None:
            return f"= {self.equals}"
        if self.near is not None:
            return f"within {number(self.decades)} decades of {number(self.near)}"
        sides = ((">=", self.lower), ("<=", self.upper))
        return " and ".join(f"{sign} {number(value)}" for sign, value in sides if value is not None)

    @property
    def title(self) -> str:
        """The gate on one line: its patterns, measure and bound."""
        at = f" at {step(self.dt_s)} s" if self.dt_s is not None else ""
        at += f" at tolerance {step(self.tolerance)}" if self.tolerance is not None else ""
        return f"{self.scenario} {self.engine}:{self.method}{at}: {self.measure} {self.bound}"

    def matches_scenario(self, name: str) -> bool:
        """Whether the pattern matches the name of a scenario or of its family."""
        return fnmatchcase(name, self.scenario) or fnmatchcase(name.partition("/")[0], self.scenario)

    def matches_engine(self, engine: str) -> bool:
        """Whether the pattern matches the name of an engine."""
        return any(fnmatchcase(name, self.engine) for name in (engine, requested_name(engine)))

    def matches_method(self, engine: str, method: str) -> bool:
        """Whether the patterns match an engine and one of its methods."""
        return self.matches_engine(engine) and fnmatchcase(method, self.method)

    def concerns(self, engines: Sequence[str]) -> bool:
        """Whether the patterns match one of the engines or methods that --engine names; no names are all."""
        parts = [split_method(name) for name in engines]
        return not parts or any(
            (is_command(engine) and self.engine not in engine_names())  # it has not announced its name
            or (self.matches_method(engine, method) if method else self.matches_engine(engine))
            for engine, _, method in parts
        )

    def matches_setting(self, dt_s: float | None, tolerance: float | None) -> bool:
        """Whether a case has the step or the tolerance that the gate names, if it names one."""
        return _matches(self.dt_s, dt_s) and _matches(self.tolerance, tolerance)


class ChangeThreshold(TomlTable):
    """The size above which a change of one measure is worse or improved.

    measure: one by which runs are compared. threshold: relative to the smaller of the two values; for
    order.MEASURE, how far an order may lie below theory.
    """

    measure: StrictStr
    threshold: NotNegative
    reason: StrictStr

    @field_validator("measure")
    @classmethod
    def _is_compared(cls, value: str) -> str:
        measure = measure_of(value)
        if measure.choices or value in UNCOMPARED:
            raise ValueError(f"{value} has no threshold: runs are not compared by its size")
        return value

    @field_validator("reason")
    @classmethod
    def _is_not_blank(cls, value: str) -> str:
        if not value.strip():
            raise ValueError("must give the reason for this threshold")
        return value


def _matches(requested: float | None, found: float | None) -> bool:
    return requested is None or (found is not None and math.isclose(requested, found, rel_tol=1e-9))


GATE_TABLE = re.compile(r"^[ \t]*\[\[[ \t]*gate[ \t]*\]\]", flags=re.MULTILINE)
"""The head of the table of a gate."""


def gate_lines(text: str, gates: int) -> list[int]:
    """Return the line of each gate's table in the text of a file; 1 for gates written otherwise."""
    found = [text.count("\n", 0, head.start()) + 1 for head in GATE_TABLE.finditer(text)]
    return found if len(found) == gates else [1] * gates


def read_gates(path: Path) -> tuple[Gate, ...]:
    """Read the gates of a tolerance file.

    Raises InputError with one line per error, each with its place in the file.
    """
    return parse_gates(read_text(path), str(path))


def parse_gates(text: str, where: str) -> tuple[Gate, ...]:
    """Parse TOML text as read_gates does; `where` is its name in messages."""
    gates, _, faults = parsed(text, where)
    if not gates and not any(fault.startswith((f"{where}: gate[", f"{where}: gate:")) for fault in faults):
        faults.append(f"{where}: gate: needs at least one [[gate]] table: a file without gates must not pass")
    if faults:
        raise InputError("\n".join(faults))
    return gates


def read_thresholds(path: Path, default: float) -> Thresholds:
    """Read the [[change]] tables of a tolerance file.

    default: the threshold of all other measures. Raises InputError as read_gates does.
    """
    _, changes, faults = parsed(read_text(path), str(path))
    if faults:
        raise InputError("\n".join(faults))
    return Thresholds(default, {change.measure: change.threshold for change in changes})


def parsed(text: str, where: str) -> tuple[tuple[Gate, ...], tuple[ChangeThreshold, ...], list[str]]:
    """Return the [[gate]] and [[change]] tables of TOML text, and all errors in it."""
    data = parse_toml(text, where)
    gates, faults = _tables(data.pop("gate", []), "gate", gate_of)
    changes, more = _tables(data.pop("change", []), "change", threshold_of)
    faults += more
    twice = [name for name, times in Counter(change.measure for change in changes).items() if times > 1]
    faults += [f"change: {name} has more than one threshold" for name in twice]
    unknown = [f"{key}: unknown key (a tolerance file has [[gate]] and [[change]] tables)" for key in data]
    return tuple(gates), tuple(changes), [f"{where}: {fault}" for fault in (*unknown, *faults)]


def _tables(tables: Any, name: str, made: Callable[[Any, str], _Made]) -> tuple[list[_Made], list[str]]:
    """Return the parsed tables of one name, and the errors of those that cannot be parsed."""
    if not isinstance(tables, list):
        return [], [f"{name}: needs [[{name}]] tables, not one [{name}]"]
    found: list[_Made] = []
    faults: list[str] = []
    for index, table in enumerate(tables):
        try:
            found.append(made(table, f"{name}[{index}]"))
        except InputError as error:
            faults += str(error).splitlines()
    return found, faults


def threshold_of(table: Any, where: str) -> ChangeThreshold:
    """Return the threshold that one table describes.

    Raises InputError with one line per error, each beginning with `where`.
    """
    try:
        return ChangeThreshold.model_validate(table)
    except ValidationError as error:
        raise InputError("\n".join(_faults_of_keys(error, where))) from None


def _faults_of_keys(error: ValidationError, where: str) -> list[str]:
    return [f"{where}.{line}" if line[0] != ":" else where + line for line in fault_lines(error)]


def gate_of(table: Any, where: str) -> Gate:
    """Return the gate that one table describes.

    Raises InputError with one line per error, each beginning with `where`.
    """
    faults = [f"{where}: {fault}" for fault in _faults_together(table)]
    try:
        gate = Gate.model_validate(table)
    except ValidationError as error:
        raise InputError("\n".join([*_faults_of_keys(error, where), *faults])) from None
    if faults:
        raise InputError("\n".join(faults))
    return gate


def _faults_together(table: Any) -> Iterator[str]:
    """Yield the errors between the keys of a gate, whether or not each key is valid by itself."""
    if not isinstance(table, Mapping):
        return
    given = [name for name in _BOUNDS if name in table]
    if not given:
        yield "needs a bound: upper, lower, near with decades, or equals"
    if ("near" in table) != ("decades" in table):
        yield "near and decades must be given together (0.3 decades is a factor of 2)"
    elif "near" in given and {"upper", "lower"} & set(given):
        yield "give near and decades, or upper and lower, not both"
    if {"dt_s", "tolerance"} <= table.keys():
        yield "dt_s and tolerance: a case has only one of them; remove the other"
    if _is_number(table.get("lower")) and _is_number(table.get("upper")) and table["lower"] > table["upper"]:
        yield f"lower {table['lower']!r} is above upper {table['upper']!r}"
    try:
        measure = measure_of(table.get("measure", ""))
    except (AttributeError, ValueError):
        return
    yield from _faults_of_measure(table, given, measure)


def _faults_of_measure(table: Mapping[str, Any], given: list[str], measure: GateMeasure) -> Iterator[str]:
    name = table["measure"]
    if measure.choices:
        if given and given != ["equals"]:
            yield f"{name} is a word: use equals (available: {', '.join(measure.choices)})"
        elif given and table["equals"] not in measure.choices:
            yield f"equals: unknown {name} {table['equals']!r} (available: {', '.join(measure.choices)})"
    elif "equals" in given:
        yield f"equals: {name} is a number: use upper, lower, or near with decades"
    if "floor" in table and (measure.choices or not measure.in_decades):
        yield f"floor: does not apply to {name}: only errors and times have a floor"
    if measure.source != "results":
        for key in {"dt_s", "tolerance"} & table.keys():
            yield f"{key}: {name} covers all steps; remove {key}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
