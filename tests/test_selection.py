"""Scenarios, engines, steps and times as Python arguments, and how invalid ones are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bodycheck
from bodycheck.runs.selection import select
from tests.helpers.expected_messages import ExpectedMessage


@pytest.mark.slow
def test_steps_and_tolerances_may_be_an_array() -> None:
    """Arrays become Python floats, whose repr appears in the reproducing commands."""
    made = select(
        ["intermediate-axis"],
        ["reference:rk4", "reference:taylor"],
        np.array([0.02, 0.01]),
        np.float64([1e-6]),
    )
    assert repr(made.dt_s) == "(0.02, 0.01)"
    assert repr(made.tolerances) == "(1e-06,)"
    assert select(["intermediate-axis"], ["reference:rk4"], np.array([])).dt_s is None


@pytest.mark.parametrize(
    "arguments",
    [
        {"scenarios": "smoke"},
        {"scenarios": Path("smoke.toml")},
        {"scenarios": [Path("smoke.toml"), 3]},
        {"engines": []},
        {"dt_s": np.array([])},
        {"dt_s": np.array(0.01)},
        {"engines": [Path("reference")]},
        {"jobs": 1.5},
        {"timeout_s": "2"},
        {"engines": "dart"},
        {"dt_s": 1e-3},
        {"dt_s": "1e-3"},
        {"tolerances": [None]},
        {"scenarios": []},
    ],
)
def test_arguments_of_a_wrong_type_or_without_an_element_are_refused(
    arguments: dict[str, Any], expected_message: ExpectedMessage
) -> None:
    """One line states the valid form; a string is not treated as a list of letters."""
    with expected_message.raises(bodycheck.InputError):
        bodycheck.run(**arguments)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("method", "settings"),
    [("reference:rk4", {"tolerances": [1e-6]}), ("reference:taylor", {"dt_s": [0.01]})],
)
def test_steps_and_tolerances_that_no_method_has_are_refused(
    method: str, settings: dict[str, Any], expected_message: ExpectedMessage
) -> None:
    """They would be ignored; next to a method that has them, they are not."""
    with expected_message.raises(bodycheck.InputError):
        select(["sphere"], [method], **settings)
    assert select(["sphere"], ["reference:rk4", "reference:taylor"], **settings)


def test_names_may_come_from_an_iterator() -> None:
    """They are read once."""
    names = ("sphere", "full-tensor")
    found = select((name for name in names), (f"reference:{m}" for m in ("m1", "rk4")))  # type: ignore[arg-type]
    assert [scenario.name for _, scenario in found.scenarios] == list(names)
    assert [method.name for _, method in found.methods] == ["m1", "rk4"]


@pytest.mark.parametrize("at", [5.0, [[0.0, 1.0]], "1", ["soon"], [1j], [None]])
def test_times_are_a_list_of_numbers(at: Any) -> None:
    """A single number, a table or a text is refused."""
    with pytest.raises(bodycheck.InputError):
        bodycheck.truth("intermediate-axis", at)


@pytest.mark.parametrize(
    "call",
    [
        lambda: bodycheck.truth(3, [0.0]),  # type: ignore[arg-type]
        lambda: bodycheck.load_scenario(None),  # type: ignore[arg-type]
        lambda: bodycheck.judge(None, "sphere"),  # type: ignore[arg-type]
        lambda: bodycheck.judge("a.csv", "sphere", column_map=3),  # type: ignore[arg-type]
        lambda: bodycheck.judge("a.csv", "sphere", column_map={3: "q*"}),  # type: ignore[dict-item]
    ],
    ids=["truth", "load_scenario", "judge", "column_map", "key"],
)
def test_names_and_maps_of_a_wrong_type_are_refused(call: Callable[[], object]) -> None:
    """The error is that of any other wrong input."""
    with pytest.raises(bodycheck.InputError):
        call()


@pytest.mark.slow
def test_variants_for_off_centre_links_run_only_there() -> None:
    """An engine's name adds them only for links off the centre of mass; a variant's name, for all."""
    selection = select(["off-centre-link", "sphere"], ["mujoco", "reference:rk4"])
    runs = {
        (scenario.name, method.name)
        for _, scenario in selection.scenarios
        for engine, method in selection.methods
        if engine.name == "mujoco" and selection.runs_on(scenario, engine, method)
    }
    assert ("off-centre-link", "euler@unaligned") in runs
    assert ("off-centre-link", "euler") in runs
    assert {method for scenario, method in runs if scenario == "sphere" and "@" in method} == set()
    assert not any(method.endswith(("@welded", "@defaults")) for _, method in runs)
    assert selection.cases_listed() == 5 * (10 + 5) + 5 * 2

    requested = select(["off-centre-link", "sphere"], ["mujoco:euler@unaligned"])
    assert [method.name for _, method in requested.methods] == ["euler@unaligned"]
    assert all(
        requested.runs_on(scenario, engine, method)
        for _, scenario in requested.scenarios
        for engine, method in requested.methods
    )
