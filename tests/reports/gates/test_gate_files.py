"""The format of a tolerance file, and its refusals."""

from __future__ import annotations

from pathlib import Path

import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.gate import UNCOMPARED, measure_of, parse_gates, read_gates, read_thresholds
from bodycheck.reports.gates.thresholds import THRESHOLD, Thresholds
from bodycheck.reports.measurement.study import QUANTITIES
from bodycheck.reports.run_files.tables import TABLES
from tests.helpers.expected_messages import ExpectedMessage

GATE = '[[gate]]\nmeasure = "energy_drift"\nupper = 1e-3\nreason = "because"\n'

WRONG = {
    "no TOML": ("[[gate", "tolerances.toml: is not TOML"),
    "empty": ("", "gate: needs at least one [[gate]] table"),
    "one table": ("[gate]\nupper = 1\n", "gate: needs [[gate]] tables, not one [gate]"),
    "gates that are numbers": ("gate = [1]\n", "gate[0]: should be a table (it is 1)"),
    "other tables": (GATE + "[gates]\n", "gates: unknown key"),
    "unknown key": (GATE + "margin = 1.0\n", "gate[0].margin: is not a key of this table"),
    "no reason": (GATE.replace("reason", "#"), "gate[0].reason: is required"),
    "empty reason": (GATE.replace("because", " "), "gate[0].reason: must give the reason for this bound"),
    "no measure": (GATE.replace("measure", "#"), "gate[0].measure: is required"),
    "unknown measure": (
        GATE.replace("energy_drift", "energy"),
        "gate[0].measure: unknown measure 'energy'",
    ),
    "measure that is no text": (
        GATE.replace('"energy_drift"', "3"),
        "gate[0].measure: should be a valid string",
    ),
    "order of nothing": (GATE.replace("energy_drift", "order.speed"), "unknown measure 'order.speed'"),
    "no bound": (
        GATE.replace("upper", "#"),
        "gate[0]: needs a bound: upper, lower, near with decades, or equals",
    ),
    "bound that is text": (GATE.replace("1e-3", '"1e-3"'), "gate[0].upper: should be a valid number"),
    "bound that is no number": (GATE.replace("1e-3", "nan"), "gate[0].upper: should be a finite number"),
    "bounds crossed": (GATE + "lower = 1.0\n", "gate[0]: lower 1.0 is above upper 0.001"),
    "near alone": (GATE.replace("upper", "near"), "gate[0]: near and decades must be given together"),
    "decades alone": (GATE + "decades = 1.0\n", "gate[0]: near and decades must be given together"),
    "more decades than doubles have": (
        GATE.replace("upper = 1e-3", "near = 1.0\ndecades = 400.0"),
        "gate[0].decades: should be less than or equal to 300",
    ),
    "a step and a tolerance": (
        GATE + "dt_s = 0.1\ntolerance = 1e-6\n",
        "gate[0]: dt_s and tolerance: a case has only one of them",
    ),
    "near and upper": (
        GATE + "near = 1.0\ndecades = 1.0\n",
        "give near and decades, or upper and lower, not both",
    ),
    "near nothing": (
        GATE.replace("upper = 1e-3", "near = 0.0\ndecades = 1.0"),
        "gate[0].near: should be greater",
    ),
    "word for a number": (GATE.replace("upper = 1e-3", 'equals = "ok"'), "equals: energy_drift is a number"),
    "number for a word": (
        GATE.replace("energy_drift", "verdict"),
        "verdict is a word: use equals (available: ",
    ),
    "no such word": (
        '[[gate]]\nmeasure = "outcome"\nequals = "fine"\nreason = "r"\n',
        "equals: unknown outcome 'fine' (available: ok, unstable",
    ),
    "step of an order": (
        GATE.replace("energy_drift", "order.energy_drift") + "dt_s = 0.1\n",
        "dt_s: order.energy_drift covers all steps; remove dt_s",
    ),
    "floor of an order": (
        GATE.replace("energy_drift", "order.energy_drift") + "floor = 0.1\n",
        "floor: does not apply to order.energy_drift",
    ),
    "step below 0": (GATE + "dt_s = -0.1\n", "gate[0].dt_s: should be greater than 0"),
    "floor below 0": (GATE + "floor = -0.1\n", "gate[0].floor: should be greater than or equal to 0"),
    "empty pattern": (GATE + 'engine = ""\n', "gate[0].engine: should have at least 1 character"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_file_is_refused_with_its_key(what: str) -> None:
    """The message names the file, the key, the error and what would be right."""
    text, message = WRONG[what]
    with pytest.raises(InputError) as refused:
        parse_gates(text, "tolerances.toml")
    assert message in str(refused.value)
    assert all(line.startswith("tolerances.toml: ") for line in str(refused.value).splitlines())


def test_all_errors_of_a_file_are_reported_at_once() -> None:
    """Errors of keys, between keys and of other gates are reported in one line each."""
    text = GATE + GATE.replace("upper", "uper") + GATE.replace("1e-3", "inf") + "lower = 2.0\n"
    with pytest.raises(InputError) as refused:
        parse_gates(text, "t")
    assert str(refused.value).splitlines() == [
        "t: gate[1].uper: is not a key of this table; did you mean upper?",
        "t: gate[1]: needs a bound: upper, lower, near with decades, or equals",
        "t: gate[2].upper: should be a finite number (it is inf)",
    ]


def test_unreadable_file_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """A missing file, a folder and bytes that are not text are each refused in one line."""
    (tmp_path / "latin").write_bytes(b"\xff\xfe")
    for name in ("missing", ".", "latin"):
        with expected_message.raises(InputError):
            read_gates(tmp_path / name)


def test_every_measure_of_the_tables_can_be_gated() -> None:
    """Each column that a gate may name is in results.csv; order and verdict are of every quantity."""
    assert set(UNCOMPARED) <= set(TABLES["results"].columns)
    for name in TABLES["results"].columns:
        try:
            assert measure_of(name).column == name
        except ValueError:
            assert (
                not name.endswith(("_drift", "_error", "_rad", "_abs", "_balance"))
                or name == "truth_bound_rad"
            )
    for quantity in QUANTITIES:
        assert measure_of(f"order.{quantity}").column in TABLES["methods"].columns
        assert measure_of(f"verdict.{quantity}").quantity == quantity


CHANGE = '[[change]]\nmeasure = "energy_drift"\nthreshold = 0.05\nreason = "noisy"\n'


def test_thresholds_and_gates_share_a_file(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """Each command reads its own tables; without gates `gate` refuses the file."""
    file = tmp_path / "t.toml"
    gate = '[[gate]]\nmeasure = "omega_error"\nupper = 1.0\nreason = "r"\n'
    order = '[[change]]\nmeasure = "order.omega_error"\nthreshold = 0.3\nreason = "few points"\n'
    file.write_text(CHANGE + gate + order)
    assert [one.measure for one in read_gates(file)] == ["omega_error"]
    reported = {"energy_drift": 0.05, "order.omega_error": 0.3}
    assert read_thresholds(file, THRESHOLD) == Thresholds(THRESHOLD, reported)
    file.write_text(CHANGE)
    assert read_thresholds(file, 0.5) == Thresholds(0.5, {"energy_drift": 0.05})
    with expected_message.raises(InputError):
        read_gates(file)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CHANGE + CHANGE, "change: energy_drift has more than one threshold"),
        (CHANGE.replace("0.05", "-0.05"), "change[0].threshold: "),
        (CHANGE.replace("energy_drift", "beauty"), "change[0].measure: unknown measure 'beauty'"),
        (CHANGE.replace("energy_drift", "verdict"), "change[0].measure: verdict has no threshold"),
        (CHANGE.replace("energy_drift", "cpu_s"), "change[0].measure: cpu_s has no threshold"),
        (CHANGE.replace("noisy", " "), "change[0].reason: must give the reason"),
        (CHANGE.replace("[[change]]", "[change]"), "change: needs [[change]] tables, not one [change]"),
        (CHANGE + 'scenario = "x"\n', "change[0].scenario: "),
        (CHANGE + "[other]\n", "other: unknown key (a tolerance file has [[gate]] and [[change]] tables)"),
    ],
)
def test_wrong_threshold_is_refused_with_its_key(tmp_path: Path, text: str, message: str) -> None:
    """The readers of thresholds and of gates both refuse it."""
    file = tmp_path / "t.toml"
    file.write_text(text)
    for read in (lambda: read_thresholds(file, THRESHOLD), lambda: read_gates(file)):
        with pytest.raises(InputError) as refused:
            read()
        assert any(line.startswith(f"{file}: {message}") for line in str(refused.value).splitlines())
