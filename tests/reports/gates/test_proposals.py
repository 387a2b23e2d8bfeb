"""New bounds from a run: which are tightened, which loosened for a reason, and how the file is edited."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest
from gated import a_run

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.gate import gate_of, parse_gates
from bodycheck.reports.gates.proposal import Change, edited, proposals
from bodycheck.reports.gates.verdict import held

GATE = {"measure": "orientation_error_rad", "reason": "r"}


def proposed(
    table: dict[str, Any], *errors: float | None, margin: float = 0.3, loosen: bool = False
) -> list[tuple[str, float, bool]]:
    """Return key, new bound and whether that loosens, for a run with these errors."""
    run = a_run([{"orientation_error_rad": error, "dt_s": i + 1.0} for i, error in enumerate(errors)])
    results = held([gate_of({**GATE, **table}, "here")], run)
    return [(c.key, c.new, c.loosens) for c in proposals(results, margin, loosen=loosen)]


def test_a_bound_that_is_kept_with_room_to_spare_is_tightened_to_the_margin() -> None:
    """upper comes to the largest error x 10^margin, lower to the least over it, to two digits outwards."""
    assert proposed({"upper": 1.0}, 1e-9, 3e-9) == [("upper", 6.0e-9, False)]
    assert proposed({"upper": 1.0}, 3e-9, margin=0.0) == [("upper", 3e-9, False)]
    assert proposed({"lower": 1e-9}, 1.0, 3.0) == [("lower", 0.5, False)]


def test_a_bound_is_never_loosened_by_itself() -> None:
    """One that is kept within the margin stays; one that fails stays too, unless loosening is asked for."""
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
        run = a_run([{"orientation_error_rad": error}])
        assert held([gate_of({**GATE, **table, next(iter(table)): new}, "here")], run)[0].status == "passed"


@pytest.mark.parametrize("loosen", [False, True])
def test_nothing_is_proposed_where_a_case_was_not_measured(loosen: bool) -> None:
    """One empty cell and the bound stays, whatever the others say; nothing at all likewise."""
    assert proposed({"upper": 1.0}, 1e-9, None, loosen=loosen) == []
    assert proposed({"upper": 1e-3}, None, loosen=loosen) == []
    assert proposed({"upper": 1e-3}, loosen=loosen) == []


def test_no_bound_is_proposed_below_the_floor() -> None:
    """The noise floor stops the tightening."""
    assert proposed({"upper": 1.0, "floor": 1e-14}, 1e-16) == [("upper", 1e-14, False)]


def test_orders_and_words_come_from_theory_and_are_never_changed() -> None:
    """However far off they are, and whatever is asked for."""
    order = {"measure": "order.orientation_error_rad", "lower": 3.0, "reason": "r"}
    word = {"measure": "verdict", "equals": "converges", "reason": "r"}
    results = held(
        [gate_of(order, "here"), gate_of(word, "here")], a_run([{}], [{"order": 2.0, "verdict": "chaotic"}])
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


def test_all_but_the_bounds_of_a_file_stays_as_it_was() -> None:
    """Comments, blanks, order and other keys are untouched; the new text is read again."""
    changes = [
        Change(0, "upper", 1e-3, 2.5e-7, 1e-7, loosens=False),
        Change(1, "upper", 10.5, 100.0, 50.0, loosens=True),
    ]
    new = edited(TEXT, "t", changes, "a new version")
    assert new == TEXT.replace("1e-3", "2.5e-7").replace("1_0.5", "100.0").replace(
        "'second'", '"second; loosened: a new version"'
    )
    assert [gate.upper for gate in parse_gates(new, "t")] == [2.5e-7, 100.0]
    assert edited(TEXT, "t", [], None) == TEXT


def test_a_reason_is_added_once_though_both_bounds_are_loosened() -> None:
    """And not again, when the same is said once more."""
    text = '[[gate]]\nmeasure = "energy_drift"\nlower = 2.0\nupper = 3.0\nreason = "r"\n'
    both = [Change(0, "lower", 2.0, 1.0, 1.5, loosens=True), Change(0, "upper", 3.0, 4.0, 3.5, loosens=True)]
    once = edited(text, "t", both, "wider")
    assert [gate.reason for gate in parse_gates(once, "t")] == ["r; loosened: wider"]
    again = edited(once, "t", [Change(0, "upper", 4.0, 5.0, 4.5, loosens=True)], "wider")
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
def test_a_file_that_would_be_spoilt_is_refused(text: str) -> None:
    """Where the edit does not say exactly what was meant, nothing is written."""
    tomllib.loads(text)
    with pytest.raises(InputError, match="cannot be edited: write each key"):
        edited(text, "t", [Change(0, "upper", 1e-3, 1e-4, 5e-5, loosens=False)], None)
