"""The printed search of releases: where a measure changed, in as many digits as distinguish its values."""

from __future__ import annotations

import pytest

from bodycheck.reports.comparison.release_results import Found, ReleaseFinding, Track, found_document
from bodycheck.reports.document import print_document

VERSIONS = ("1.0", "1.1", "1.2", "2.0", "2.1")


def printed(
    values: dict[str, float | str | None],
    changes: tuple[tuple[str, str], ...],
    measure: str = "energy_drift",
    failed: dict[str, str] | None = None,
) -> Found:
    """Return a search of one method that found these values in the releases that were run."""
    findings = {version: ReleaseFinding(value, "too-few-points") for version, value in values.items()}
    return Found("toy", "free", measure, VERSIONS, (Track("m", findings, changes),), failed or {})


@pytest.mark.parametrize(
    ("found", "last"),
    [
        (
            printed(
                {"1.0": 2.0, "1.2": 2.0, "2.0": 4.003, "2.1": 4.0}, (("1.2", "2.0"),), "order.omega_error"
            ),
            "toy:m: 2.00 up to 1.2, 4.00 from 2.0",
        ),
        (
            printed(
                {"1.0": 1e-3, "1.1": 2e-3, "1.2": 2e-3, "2.0": 1e-9, "2.1": 1e-9},
                (("1.0", "1.1"), ("1.2", "2.0")),
            ),
            "toy:m: 0.001 up to 1.0, 0.002 from 1.1 to 1.2, 1e-9 from 2.0",
        ),
        (
            printed({"1.0": 0.12345678, "1.1": 0.12345679, "2.1": 0.12345679}, (("1.0", "1.1"),)),
            "toy:m: 0.12345678 up to 1.0, 0.12345679 from 1.1",
        ),
        (
            printed({"1.0": "converges", "2.1": "unstable"}, (("1.0", "2.1"),), "verdict"),
            "toy:m: converges up to 1.0, unstable from 2.1; 1.1, 1.2 and 2.0 between them could not be run",
        ),
        (
            printed({"1.0": 2.0, "2.1": None, "2.0": 2.0}, (("2.0", "2.1"),), "order.omega_error"),
            "toy:m: 2.00 up to 2.0, none (too-few-points) from 2.1",
        ),
        (printed({"1.0": 1e-3}, ()), "toy:m: 0.001 in 1.0, the only release run"),
        (
            printed({"1.0": 1e-3, "2.1": 1e-3}, ()),
            "toy:m: 0.001 in 2.1, as in 1.0; a change that was undone between them would be missed",
        ),
    ],
)
def test_the_first_line_says_where_it_changed(
    found: Found, last: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """It has the measure, the last release before a change, the first after it, and unknown ones between."""
    print_document(found_document(found))
    assert capsys.readouterr().out.splitlines()[0] == f"{found.measure} of {last}"


def test_what_could_not_be_run_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    """A release that could not be run is listed with its reason, verbatim, and is not counted as run."""
    failed = {"1.1": "toy==1.1 cannot be installed: :x: [no]"}
    print_document(found_document(printed({"1.0": 1e-3, "2.1": 1e-3}, (), failed=failed)))
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "energy_drift on free; 5 releases from 1.0 to 2.1, 2 of them run"
    assert "not run: 1.1: toy==1.1 cannot be installed: :x: [no]" in lines


def test_where_every_release_was_run_it_is_said_in_which_anything_changed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each release with a change is listed with its methods; a constant value is given once for all."""
    still = {version: ReleaseFinding(1e-3, "") for version in VERSIONS}
    there = {**still, "1.1": ReleaseFinding(2e-3, ""), "2.1": ReleaseFinding(3e-3, "")}
    tracks = (
        Track("a", still, ()),
        Track("b", there, (("1.0", "1.1"), ("1.1", "1.2"), ("2.0", "2.1"))),
        Track("c", there, (("1.0", "1.1"), ("1.1", "1.2"), ("2.0", "2.1"))),
    )
    print_document(found_document(Found("toy", "free", "energy_drift", VERSIONS, tracks, {}, every=True)))
    lines = capsys.readouterr().out.splitlines()
    assert "toy:a: 0.001 in all 5 releases run" in lines
    assert lines[0] == "energy_drift changed in 1.1 (b, c), 1.2 (b, c), 2.1 (b, c)"
    same = Found("toy", "free", "energy_drift", VERSIONS, tracks[:1], {}, every=True)
    print_document(found_document(same))
    assert capsys.readouterr().out.splitlines()[0] == "energy_drift changed in no release"
