"""New bounds from a run: which are tightened, which loosened with a reason, and the edit of the file."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.gate import gate_of, parse_gates
from bodycheck.reports.gates.proposal import BoundChange, edited, proposals
from bodycheck.reports.gates.verdict import check_gates
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.gate_tables import make_tables

GATE = {"measure": "orientation_error_rad", "reason": "r"}


def proposed(
    table: dict[str, Any], *errors: float | None, margin: float = 0.3, loosen: bool = False
) -> list[tuple[str, float, bool]]:
    """Return key, new bound and whether that loosens, for a run with these errors."""
    run = make_tables([{"orientation_error_rad": error, "dt_s": i + 1.0} for i, error in enumerate(errors)])
    results = check_gates([gate_of({**GATE, **table}, "here")], run)
    return [(c.key, c.new, c.loosens) for c in proposals(results, margin, loosen=loosen)]


def test_bound_met_with_room_is_tightened_to_the_margin() -> None:
    """upper becomes the largest error x 10^margin, lower the least / 10^margin, to two digits outwards."""
    assert proposed({"upper": 1.0}, 1e-9, 3e-9) == [("upper", 6.0e-9, False)]
    assert proposed({"upper": 1.0}, 3e-9, margin=0.0) == [("upper", 3e-9, False)]
    assert proposed({"lower": 1e-9}, 1.0, 3.0) == [("lower", 0.5, False)]


def test_bound_is_never_loosened_without_request() -> None:
    """A bound met within the margin stays; a failed one stays unless loosening is requested."""
    assert proposed({"upper": 1e-3}, 0.9e-3) == []
    assert proposed({"upper": 1e-3}, 0.9e-3, loosen=True) == []
    for table, error in (
        ({"upper": 1e-3}, 2e-3),
        ({"lower": 1e-3}, 5e-4),
        ({"near": 1.0, "decades": 0.1}, 0.1),
    ):
        assert proposed(table, error) == []
        ((_, new, loosens),) = proposed(table, error, loosen=True)
        assert loosens
        run = make_tables([{"orientation_error_rad": error}])
        (result,) = check_gates([gate_of({**GATE, **table, next(iter(table)): new}, "here")], run)
        assert result.status == "passed"


@pytest.mark.parametrize("loosen", [False, True])
def test_nothing_is_proposed_if_a_case_was_not_measured(loosen: bool) -> None:
    """One empty cell keeps the bound, whatever the others are."""
    assert proposed({"upper": 1.0}, 1e-9, None, loosen=loosen) == []
    assert proposed({"upper": 1e-3}, None, loosen=loosen) == []
    assert proposed({"upper": 1e-3}, loosen=loosen) == []


def test_no_bound_is_proposed_below_the_floor() -> None:
    """The noise floor limits the tightening."""
    assert proposed({"upper": 1.0, "floor": 1e-14}, 1e-16) == [("upper", 1e-14, False)]


def test_bounds_of_orders_and_words_are_never_changed() -> None:
    """Such bounds come from theory."""
    order = {"measure": "order.orientation_error_rad", "lower": 3.0, "reason": "r"}
    word = {"measure": "verdict", "equals": "converges", "reason": "r"}
    results = check_gates(
        [gate_of(order, "here"), gate_of(word, "here")],
        make_tables([{}], [{"order": 2.0, "verdict": "chaotic"}]),
    )
    assert [result.status for result in results] == ["failed", "failed"]
    assert proposals(results, 0.3, loosen=True) == []


TEXT = """# ours
[[gate]] # the first
measure = "energy_drift"
upper = 1e-3 # generous
reason = "a \\"word\\""

  [[ gate ]]
  reason = 'second' # why
  lower=5
  upper   =   1_0.5
  measure = "omega_error"
"""


def test_only_bounds_of_a_file_are_changed() -> None:
    """Comments, blanks, order and other keys stay; the new text can be read."""
    changes = [
        BoundChange(0, "upper", 1e-3, 2.5e-7, 1e-7, loosens=False),
        BoundChange(1, "upper", 10.5, 100.0, 50.0, loosens=True),
    ]
    new = edited(TEXT, "t", changes, "a new version")
    assert new == TEXT.replace("1e-3", "2.5e-7").replace("1_0.5", "100.0").replace(
        "'second'", '"second; loosened: a new version"'
    )
    assert [gate.upper for gate in parse_gates(new, "t")] == [2.5e-7, 100.0]
    assert edited(TEXT, "t", [], None) == TEXT


def test_reason_is_added_once() -> None:
    """The reason is added once for both bounds, and not again if it is repeated."""
    text = '[[gate]]\nmeasure = "energy_drift"\nlower = 2.0\nupper = 3.0\nreason = "r"\n'
    both = [
        BoundChange(0, "lower", 2.0, 1.0, 1.5, loosens=True),
        BoundChange(0, "upper", 3.0, 4.0, 3.5, loosens=True),
    ]
    once = edited(text, "t", both, "wider")
    assert [gate.reason for gate in parse_gates(once, "t")] == ["r; loosened: wider"]
    again = edited(once, "t", [BoundChange(0, "upper", 4.0, 5.0, 4.5, loosens=True)], "wider")
    assert again == once.replace("4.0", "5.0")


@pytest.mark.parametrize(
    "text",
    [
        'gate = [{measure = "energy_drift", upper = 1e-3, reason = "r"}]\n',
        '[[gate]]\nmeasure = "energy_drift"\n"upper" = 1e-3\nreason = "r"\n',
        '[[gate]]\nreason = """\nupper = 3\n"""\nmeasure = "energy_drift"\nupper = 1e-3\n',
    ],
    ids=["inline", "quoted key", "bound in a text"],
)
def test_edit_with_another_meaning_is_refused(text: str, expected_message: ExpectedMessage) -> None:
    """If the edited file does not have exactly the new bounds, nothing is written."""
    tomllib.loads(text)
    with expected_message.raises(InputError):
        edited(text, "t", [BoundChange(0, "upper", 1e-3, 1e-4, 5e-5, loosens=False)], None)
