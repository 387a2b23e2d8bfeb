"""A tolerance file: one [[gate]] a bound, with its reason; read whole, or refused with all its errors."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, StrictStr, ValidationError, field_validator

from bodycheck.errors import InputError
from bodycheck.reports.gates.measure import Measure, measure_of
from bodycheck.reports.wording import number, step
from bodycheck.scenarios.fields import NotNegative, Number, Positive, Table
from bodycheck.scenarios.reader import fault_lines

_Pattern = Annotated[StrictStr, Field(min_length=1)]
"""A name, with * for any letters, ? for any one, [ab] for one of these."""

_MOST_DECADES = 300.0  # a factor of more would be no number

_BOUNDS = ("upper", "lower", "near", "equals")


class Gate(Table):
    """One bound on one measure of all the cases that its patterns match.

    scenario matches a name or the family's, engine and method theirs; dt_s in s or tolerance choose one
    step. upper and lower include the bound itself; near and decades stand for near x 10^-decades and
    near x 10^decades; equals is a word. Values and bounds below floor count as floor.
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
    decades: Annotated[Positive, Field(le=_MOST_DECADES)] | None = None
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
    def _says_something(cls, value: str) -> str:
        if not value.strip():
            raise ValueError("must say why this bound")
        return value

    @cached_property
    def looks_at(self) -> Measure:
        """What `measure` stands for."""
        return measure_of(self.measure)

    @property
    def least(self) -> float | None:
        """The smallest value that passes, if there is one."""
        return self.lower if self.near is None else self.near / 10.0 ** (self.decades or 0.0)

    @property
    def most(self) -> float | None:
        """The largest value that passes, if there is one."""
        return self.upper if self.near is None else self.near * 10.0 ** (self.decades or 0.0)

    @property
    def bound(self) -> str:
        """The bound in words: "<= 1e-9", "within 0.1 decades of 1.4e-2", "= converges"."""
        if self.equals is not None:
            return f"= {self.equals}"
        if self.near is not None:
            return f"within {number(self.decades)} decades of {number(self.near)}"
        sides = ((">=", self.lower), ("<=", self.upper))
        return " and ".join(f"{sign} {number(value)}" for sign, value in sides if value is not None)

    @property
    def title(self) -> str:
        """The gate in one line: what it looks at, and its bound."""
        at = f" at {step(self.dt_s)} s" if self.dt_s is not None else ""
        at += f" at tolerance {step(self.tolerance)}" if self.tolerance is not None else ""
        return f"{self.scenario} {self.engine}:{self.method}{at}: {self.measure} {self.bound}"

    def wants_scenario(self, name: str) -> bool:
        """Whether the pattern is met by a scenario's name, or by the name of its family."""
        return fnmatchcase(name, self.scenario) or fnmatchcase(name.partition("/")[0], self.scenario)

    def wants_engine(self, engine: str) -> bool:
        """Whether the pattern is met by an engine's name."""
        return fnmatchcase(engine, self.engine)

    def wants_method(self, engine: str, method: str) -> bool:
        """Whether the patterns are met by an engine and one of its methods."""
        return self.wants_engine(engine) and fnmatchcase(method, self.method)

    def wants_setting(self, dt_s: float | None, tolerance: float | None) -> bool:
        """Whether a case was told the step or the tolerance that the gate names, if it names one."""
        return _same(self.dt_s, dt_s) and _same(self.tolerance, tolerance)


def _same(asked: float | None, found: float | None) -> bool:
    return asked is None or (found is not None and math.isclose(asked, found, rel_tol=1e-9))


def read_gates(path: Path) -> tuple[Gate, ...]:
    """Read a tolerance file; raises InputError with one line an error, each with its place in the file."""
    try:
        return parse_gates(path.read_bytes().decode("utf-8-sig"), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text: {error.reason} at byte {error.start}") from None


def parse_gates(text: str, where: str) -> tuple[Gate, ...]:
    """Read TOML text as read_gates does; `where` names it in messages."""
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{where}: is nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: is not TOML: {error}") from None
    tables = data.pop("gate", [])
    faults = [f"{key}: is no key of this file: it has [[gate]] tables" for key in data]
    if not isinstance(tables, list) or not tables:
        faults.append("gate: needs at least one [[gate]] table: what gates nothing must not pass")
        tables = []
    gates = []
    for place, table in enumerate(tables):
        try:
            gates.append(gate_of(table, f"gate[{place}]"))
        except InputError as error:
            faults += str(error).splitlines()
    if faults:
        raise InputError("\n".join(f"{where}: {fault}" for fault in faults))
    return tuple(gates)


def gate_of(table: Any, where: str) -> Gate:
    """Return the gate of one table; raises InputError with one line an error, `where` before each."""
    faults = [f"{where}: {fault}" for fault in _faults_together(table)]
    try:
        gate = Gate.model_validate(table)
    except ValidationError as error:
        own = [f"{where}.{line}" if line[0] != ":" else where + line for line in fault_lines(error)]
        raise InputError("\n".join([*own, *faults])) from None
    if faults:
        raise InputError("\n".join(faults))
    return gate


def _faults_together(table: Any) -> Iterator[str]:
    """Yield what is wrong between the keys of a gate, whether or not each is right by itself."""
    if not isinstance(table, Mapping):
        return
    given = [name for name in _BOUNDS if name in table]
    if not given:
        yield "needs a bound: upper, lower, near with decades, or equals"
    if ("near" in table) != ("decades" in table):
        yield "near and decades belong together: 0.3 decades are a factor of 2"
    elif "near" in given and {"upper", "lower"} & set(given):
        yield "give near and decades, or upper and lower, not both"
    if {"dt_s", "tolerance"} <= table.keys():
        yield "dt_s and tolerance: a case is told one of them; leave the other out"
    if _is_number(table.get("lower")) and _is_number(table.get("upper")) and table["lower"] > table["upper"]:
        yield f"lower {table['lower']!r} is above upper {table['upper']!r}"
    try:
        measure = measure_of(table.get("measure", ""))
    except (AttributeError, ValueError):
        return
    yield from _faults_of_measure(table, given, measure)


def _faults_of_measure(table: Mapping[str, Any], given: list[str], measure: Measure) -> Iterator[str]:
    name = table["measure"]
    if measure.words:
        if given and given != ["equals"]:
            yield f"{name} is a word: its bound is equals, one of {', '.join(measure.words)}"
        elif given and table["equals"] not in measure.words:
            yield f"equals: {name} is never {table['equals']!r}, but one of {', '.join(measure.words)}"
    elif "equals" in given:
        yield f"equals: {name} is a number: its bounds are upper, lower, or near with decades"
    if "floor" in table and (measure.words or not measure.in_decades):
        yield f"floor: {name} has none: below a floor lies noise of an error or a time"
    if measure.source != "results":
        for key in {"dt_s", "tolerance"} & table.keys():
            yield f"{key}: {name} is of all steps together; leave it out"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
