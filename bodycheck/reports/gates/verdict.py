"""Check gates against a run: the rows that each gate matches, with their commands, and its bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any, Literal

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import names, number, setting, step
from bodycheck._util.untrusted import shell_join, shell_split
from bodycheck.adapters.engine_names import is_named, with_method
from bodycheck.reports.gates.gate import Gate
from bodycheck.reports.measurement.measures import MEASURE_OF, MEASURES
from bodycheck.reports.measurement.order import MIN_POINTS
from bodycheck.reports.measurement.verdicts import QuantityVerdict, amount_of, method_verdict
from bodycheck.reports.run_files.run_tables import StudyKey, Tables, key_of, study_key
from bodycheck.scenarios.serialization import deserialized


@dataclass(frozen=True)
class GateRow:
    """The value of one case, or of one method on one scenario, or the reason why there is none.

    at: the step or the tolerance as text; "" if the row covers all steps. obtained: a finite number or a
    word; None if there is none, and then why. about: the quantity that decided a word, with size and step.
    errors: for an order, the error at each step as text, coarsest first. is_wrong: whether there is no order
    because the method does not converge to the truth, or its error grows.
    """

    scenario: str
    engine: str
    method: str
    at: str
    obtained: float | str | None
    why: str
    reproduce: str
    about: str = ""
    errors: tuple[str, ...] = ()
    is_wrong: bool = False


def rows_of(gate: Gate, run: Tables) -> list[GateRow]:
    """Return all rows that the gate's patterns match and the measure applies to, in the order of the run."""
    measure = gate.target
    applies = _Applicability(gate, run)
    if measure.source == "results":
        cases = [case.columns for case in run.cases if _matches(gate, case.columns)]
        return [_row_of_case(gate, columns) for columns in cases if applies.include(columns)]
    if measure.source == "laws":
        return list(_rows_of_law(gate, run))
    if measure.source == "dynamics":
        return list(_rows_of_dynamics(gate, run))
    rows = run.rows(measure.source)
    found: Mapping[StudyKey, Mapping[str, Any]] = (
        _worst_verdicts(rows)
        if measure.column == "verdict" and measure.quantity is None
        else {study_key(row): row for row in rows if measure.quantity in (None, row.get("quantity"))}
    )
    # a method without a verdict on a scenario has no row in the table, but has cases, and must not pass
    pairs = {study_key(case.columns): case.columns for case in run.cases}
    return [
        _row_of_method(gate, columns, found.get(pair, {}), run)
        for pair, columns in pairs.items()
        if _matches(gate, columns) and applies.include(columns)
    ]


class _Applicability:
    """Which cases of a run a gate can judge: a scene may lack the measure, and a method may move no trees."""

    def __init__(self, gate: Gate, run: Tables) -> None:
        measure = MEASURES.get(gate.target.quantity or "") or MEASURE_OF.get(gate.target.column)
        self._of = None if measure is None else measure.of
        self._manifest, self._lacking = run.manifest, dict[str, bool]()
        scenarios = run.manifest.get("scenarios", {})
        self._trees = {name for name, data in scenarios.items() if isinstance(data.get("body"), list)}
        self._movers = {
            key_of(case.columns)
            for case in run.cases
            if case.columns["scenario"] in self._trees and case.columns["outcome"] != "unsupported"
        }
        self._expects_refusal = gate.equals == "unsupported"

    def refuses_trees(self, columns: Mapping[str, Any]) -> bool:
        """Whether a case is one of a tree, and its method moves no tree of the run."""
        is_refused = columns["scenario"] in self._trees and key_of(columns) not in self._movers
        return is_refused and not self._expects_refusal

    def lacks(self, scenario: str) -> bool:
        """Whether a scene does not have the measure."""
        if self._of is None:
            return False
        if scenario not in self._lacking:
            try:
                scene = deserialized(self._manifest["scenarios"][scenario], scenario).scene
            except (KeyError, InputError):  # with a function, or of an earlier version: no reason to pass
                self._lacking[scenario] = False
            else:
                self._lacking[scenario] = not self._of(scene)
        return self._lacking[scenario]

    def include(self, columns: Mapping[str, Any]) -> bool:
        """Whether the gate judges a case, or a method on a scenario."""
        return not self.refuses_trees(columns) and not self.lacks(columns["scenario"])


def _rows_of_law(gate: Gate, run: Tables) -> Iterator[GateRow]:
    """Yield one row per method: a law is checked in scenes of its own, whatever the gate's scenario."""
    found = {key_of(row): row for row in run.rows("laws") if row["law"] == gate.target.quantity}
    methods = {key_of(case.columns): case.columns for case in run.cases if _matches(gate, case.columns)}
    for key, columns in methods.items():
        row = found.get(key, {})
        size = row.get("size")
        why = "" if size is not None else f"no {gate.measure}: {row.get('message') or 'not checked'}"
        command = row.get("reproduce", columns["reproduce"])
        yield GateRow("(its own)", *key, at="", obtained=size, why=why, reproduce=command)


def _rows_of_dynamics(gate: Gate, run: Tables) -> Iterator[GateRow]:
    """Yield one row per engine: its readings of trees, whatever the gate's scenario and method."""
    for row in run.rows("dynamics"):
        if row["reading"] == gate.target.quantity and gate.matches_engine(row["engine"]):
            value = row.get("worst")
            why = "" if value is not None else f"no {gate.measure}: {row['verdict']}: {row['message']}"
            reproduce = f"bodycheck dynamics {row['engine']}"
            yield GateRow("(trees)", row["engine"], "", at="", obtained=value, why=why, reproduce=reproduce)


def _worst_verdicts(rows: Iterable[Mapping[str, Any]]) -> dict[StudyKey, Mapping[str, Any]]:
    """Return the most severe verdict of each method on each scenario, with the quantity that decided it."""
    quantities: dict[StudyKey, dict[str, QuantityVerdict]] = {}
    for row in rows:
        quantities.setdefault(study_key(row), {})[row["quantity"]] = QuantityVerdict.of(row)
    worst = {pair: method_verdict(verdicts) for pair, verdicts in quantities.items()}
    return {
        pair: {"verdict": one.state, "about": one.text if one.is_wrong else ""}
        for pair, one in worst.items()
        if one is not None
    }


def _matches(gate: Gate, columns: Mapping[str, Any]) -> bool:
    return all(condition(gate, columns) for condition in _KEYS.values())


def _row_of_case(gate: Gate, columns: Mapping[str, Any]) -> GateRow:
    value: Any = columns.get(gate.target.column)
    why = ""
    if gate.target.column != "outcome":
        if columns["outcome"] != "ok":
            value, why = None, f"{columns['outcome']}: {columns['message']}"
        elif not _is_finite(value):
            value, why = None, f"{gate.measure} was not measured"
    return GateRow(
        **_identity(columns), at=at_of(columns), obtained=value, why=why, reproduce=columns["reproduce"]
    )


def _row_of_method(gate: Gate, columns: Mapping[str, Any], found: Mapping[str, Any], run: Tables) -> GateRow:
    measure = gate.target
    value = found.get(measure.column)
    is_order = measure.column == "order"
    why, is_wrong = "", False
    if value is None or (not measure.choices and not _is_finite(value)):
        value, detail = None, found.get("message") or columns["message"] or "no result"
        if "verdict" in found:
            verdict = QuantityVerdict.of(found)
            is_wrong = is_order and verdict.is_wrong
            detail = verdict.text if verdict.is_wrong else verdict.state
            if is_order and verdict.state in ("converges", "too-few-points") and found.get("finest_dt_s"):
                detail += f", but {_no_order(found.get('points') or 0)}"
        why = f"no {measure.column}: {detail}"
    elif is_order and (doubt := _left_open(gate, value, found)):
        value, why = None, doubt
    return GateRow(
        **_identity(columns),
        at="",
        obtained=value,
        why=why,
        reproduce=_full_command(columns, run.manifest),
        about=found.get("about", ""),
        errors=_errors_by_step(columns, measure.quantity or "", run) if is_order else (),
        is_wrong=is_wrong,
    )


def _left_open(gate: Gate, order: float, found: Mapping[str, Any]) -> str:
    """Return why an order off a bound may yet keep it, by its 95 % interval; "" where it does not."""
    low, high = found["order_low"], found["order_high"]
    is_open = (gate.min_value is not None and order < gate.min_value <= high) or (
        gate.max_value is not None and low <= gate.max_value < order
    )
    if not is_open:
        return ""
    return (
        f"order {number(order, 3)}, but with 95 % anything from {number(low, 3)} to {number(high, 3)}, "
        "so that it may keep the bound; where the finest errors are near round-off, take coarser steps"
    )


def _no_order(points: int) -> str:
    """Return why the errors of a method that converges have no order."""
    if points < MIN_POINTS:
        return f"an order takes at least {MIN_POINTS} steps with errors above round-off, not {points}"
    return "the errors follow no one power of dt; where the finest are near round-off, take coarser steps"


def _errors_by_step(columns: Mapping[str, Any], quantity: str, run: Tables) -> tuple[str, ...]:
    """Return the error at each step of a method on a scenario, with the order between neighbouring steps."""
    own = [
        (dt_s, case)
        for case in run.cases
        if study_key(case.columns) == study_key(columns) and (dt_s := case.dt_s) is not None
    ]
    lines, coarser = [], None
    for dt_s, case in sorted(own, key=lambda one: -one[0]):
        error = case.columns.get(quantity) if case.ok else None
        if error is None:
            lines.append(f"{at_of(case.columns)}: {case.columns['outcome']}: {case.columns['message']}")
            continue
        point = (dt_s, error)
        order = "" if coarser is None else _order_between(coarser, point)
        lines.append(f"{at_of(case.columns)}: {amount_of(quantity, error)}{order}")
        coarser = point
    return tuple(lines)


def _order_between(coarser: tuple[float, float], finer: tuple[float, float]) -> str:
    """log(e1 / e2) / log(h1 / h2) as text; "" where an error is 0."""
    if min(coarser[1], finer[1]) <= 0.0:
        return ""
    order = math.log(coarser[1] / finer[1]) / math.log(coarser[0] / finer[0])
    return f", order {round(order, 2) + 0.0:.2f}"


def _identity(columns: Mapping[str, Any]) -> dict[str, Any]:
    return {name: columns[name] for name in ("scenario", "engine", "method")}


def _is_finite(value: Any) -> bool:
    return value is not None and abs(value) < float("inf")


def _full_command(columns: Mapping[str, Any], manifest: Mapping[str, Any]) -> str:
    """Return the command that runs a case's method at all steps of the run."""
    arguments = shell_split(columns["reproduce"])
    for option, values in (("--dt", manifest["dt_s"]), ("--tolerance", manifest["tolerances"])):
        if option in arguments:
            index = arguments.index(option)
            arguments[index : index + 2] = [option, ",".join(map(repr, values))] if values else []
    return shell_join(arguments)


def why_none(gate: Gate, run: Tables) -> str:
    """Return why a gate has no rows: it does not apply to what it matches, or the first key without a match.

    Of such a key, also the available values.
    """
    cases: list[Mapping[str, Any]] = [case.columns for case in run.cases]
    if reasons := left_out(gate, run):
        return "; ".join(reasons)
    remaining = accumulate(
        _KEYS.values(),
        lambda left, meets: [one for one in left if meets(gate, one)],
        initial=cases,
    )
    key, cases_before = next(
        (key, cases_before)
        for key, (cases_before, left) in zip(_KEYS, pairwise(remaining), strict=True)
        if not left
    )
    has = names(list(dict.fromkeys(_value_text(columns, key) for columns in cases_before)))
    missing = [entry["unavailable"] for entry in run.manifest["engines"].values() if "unavailable" in entry]
    return "; ".join(
        [f"no {key} of the run matches {_pattern(gate, key)} (available: {has or 'none'})", *missing]
    )


def left_out(gate: Gate, run: Tables) -> tuple[str, ...]:
    """Return why the gate does not apply to cases that its patterns match."""
    if gate.target.source not in ("results", "methods", "stability"):
        return ()
    applies = _Applicability(gate, run)
    matched = [case.columns for case in run.cases if _matches(gate, case.columns)]
    refusing = dict.fromkeys(with_method(*key_of(one)) for one in matched if applies.refuses_trees(one))
    lacking = dict.fromkeys(one["scenario"] for one in matched if applies.lacks(one["scenario"]))
    found = (
        (refusing, "moves no tree of the run", "move no tree of the run"),
        (lacking, f"has no {gate.measure}", f"have no {gate.measure}"),
    )
    return tuple(
        f"{names(list(some))} {one if len(some) == 1 else many}" for some, one, many in found if some
    )


_KEYS: dict[str, Callable[[Gate, Mapping[str, Any]], bool]] = {
    "scenario": lambda gate, columns: gate.matches_scenario(columns["scenario"]),
    "engine": lambda gate, columns: gate.matches_engine(columns["engine"]),
    "method": lambda gate, columns: gate.matches_method(columns["engine"], columns["method"]),
    "step": lambda gate, columns: gate.matches_setting(columns.get("dt_s"), columns.get("tolerance")),
}
"""The conditions that a case must meet, in the order in which an unmatched one is reported."""


def _pattern(gate: Gate, key: str) -> str:
    if key == "step":
        return f"{step(gate.dt_s or gate.tolerance)}"
    return str(getattr(gate, key))


def _value_text(columns: Mapping[str, Any], key: str) -> str:
    if key == "step":
        return at_of(columns)
    return str(columns[key])


def at_of(columns: Mapping[str, Any]) -> str:
    """Return the step or the tolerance of a case as text."""
    dt_s: float | None = columns.get("dt_s")
    return setting(columns["control"], columns.get("tolerance") if dt_s is None else dt_s)


@dataclass(frozen=True)
class GateCheck:
    """One row compared with the gate's bounds.

    beyond: the distance outside the nearest bound, negative inside, in decades if the measure is compared by
    ratios, else in its unit; None for words and for values that were not measured.
    """

    row: GateRow
    passed: bool
    beyond: float | None = None


@dataclass(frozen=True)
class GateResult:
    """A gate with all the rows that it matched.

    status: passed; failed; nothing, if no row matched or none was measured, which never passes; or skipped,
    if the gate concerns none of the requested engines. why: the reason of the last two. left_out: why the
    gate does not apply to some cases.
    """

    gate: Gate
    checks: tuple[GateCheck, ...]
    status: Literal["passed", "failed", "nothing", "skipped"]
    why: str = ""
    left_out: tuple[str, ...] = ()

    @property
    def is_bad(self) -> bool:
        """Whether the gate fails, or measured nothing."""
        return self.status in ("failed", "nothing")

    @property
    def failed(self) -> tuple[GateCheck, ...]:
        """The rows that did not pass."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def worst(self) -> GateCheck | None:
        """The row farthest outside, or least far inside, its bound; None if there is none.

        A failing row without a value comes after failing values, and before values that pass. Of rows at the
        same distance, as at an infinite number of decades from 0, it is the one whose value is farthest from
        the bound.
        """

        def badness(check: GateCheck) -> tuple[bool, float, float]:
            beyond = -math.inf if check.beyond is None else check.beyond
            return not check.passed, beyond, self._excess(check.row.obtained)

        return max(self.checks, key=badness, default=None)

    def _excess(self, value: float | str | None) -> float:
        """Return how far a number is above the upper or below the lower bound; 0 for words."""
        if value is None or isinstance(value, str):
            return 0.0
        above = -math.inf if self.gate.max_value is None else value - self.gate.max_value
        below = -math.inf if self.gate.min_value is None else self.gate.min_value - value
        return max(above, below)


def check_gates(gates: Sequence[Gate], run: Tables, engines: Sequence[str] = ()) -> tuple[GateResult, ...]:
    """Check each gate against a stored run; no engine is run.

    engines: as --engine names them; gates that concern none of them are skipped [default: all].
    """
    return tuple(_check_gate(gate, run, engines) for gate in gates)


def _check_gate(gate: Gate, run: Tables, engines: Sequence[str]) -> GateResult:
    if not gate.concerns(engines):
        return GateResult(gate, (), "skipped", f"does not concern {', '.join(engines)}")
    rows = (row for row in rows_of(gate, run) if is_named(engines, row.engine, row.method))
    checks = tuple(_check_row(gate, row) for row in rows)
    if not checks:
        return GateResult(gate, (), "nothing", why_none(gate, run))
    if all(check.row.obtained is None and not check.row.is_wrong for check in checks):
        reasons = dict.fromkeys(check.row.why for check in checks)
        return GateResult(gate, checks, "nothing", "; ".join(reasons))
    status: Literal["passed", "failed"] = "passed" if all(check.passed for check in checks) else "failed"
    return GateResult(gate, checks, status, left_out=left_out(gate, run))


def _check_row(gate: Gate, row: GateRow) -> GateCheck:
    if row.obtained is None:
        return GateCheck(row, passed=False)
    if isinstance(row.obtained, str):
        return GateCheck(row, passed=row.obtained == gate.equals)
    floor = -math.inf if gate.floor is None else gate.floor
    value = max(row.obtained, floor)
    sides = []
    if gate.max_value is not None:
        sides.append(_beyond(value, max(gate.max_value, floor), gate))
    if gate.min_value is not None:
        sides.append(_beyond(max(gate.min_value, floor), value, gate))
    beyond = max(sides)
    return GateCheck(row, passed=beyond <= 0.0, beyond=beyond)


def _beyond(larger: float, smaller: float, gate: Gate) -> float:
    """Return how far the first value is above the second, negative below; the sign is exact."""
    if larger == smaller:
        return 0.0
    if not gate.target.in_decades:
        return larger - smaller
    sign = 1.0 if larger > smaller else -1.0
    if min(larger, smaller) <= 0.0:
        return sign * math.inf
    # the logarithms of two neighbouring doubles may be equal
    return sign * max(abs(math.log10(larger) - math.log10(smaller)), math.ulp(0.0))


def distance(check: GateCheck, gate: Gate) -> str:
    """Return the distance of a value from its bound as text."""
    if check.beyond is None or math.isinf(check.beyond):
        return ""
    size = number(abs(check.beyond), 2)
    if not gate.target.in_decades:
        return f"{size} {'off the bound' if check.beyond > 0.0 else 'within'}"
    return f"{size} decade{'s' * (size != '1')} {'beyond' if check.beyond > 0.0 else 'within'}"
