"""The pytest plugin: fixtures, a marker, options, a summary. It imports nothing heavy until a test asks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from bodycheck.pytest_plugin.fixtures import Bench, HeldGate

_MARKER = "bodycheck(scenario, engine, method, dt_s): what the fixture `bodycheck` runs unless told otherwise"
_PROPERTY = "bodycheck"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("bodycheck", "accuracy of rigid-body engines")
    group.addoption(
        "--bodycheck-engines",
        metavar="NAME[:METHOD],...",
        help="run tests whose bodycheck marker names no engine once for each of these methods",
    )
    group.addoption(
        "--bodycheck-suite",
        metavar="SCENARIO_OR_SUITE,...",
        help="run tests whose bodycheck marker names no scenario once for each of these; gates run them too",
    )
    group.addoption(
        "--bodycheck-tolerances",
        metavar="FILE",
        help="run tests that use bodycheck_gate once for each gate of this file",
    )
    group.addoption(
        "--bodycheck-reuse",
        action="store_true",
        help="let gates use answers of earlier runs by the same build of an engine [default: run every case]",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line("markers", _MARKER)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a marked test once for each scenario and method that it leaves open; a gate's test once a gate."""
    marked = "bodycheck" in metafunc.fixturenames and metafunc.definition.get_closest_marker("bodycheck")
    if not marked and "bodycheck_gate" not in metafunc.fixturenames:
        return
    from bodycheck.pytest_plugin import fixtures

    if marked:
        fixtures.parametrize_cases(metafunc)
    if "bodycheck_gate" in metafunc.fixturenames:
        fixtures.parametrize_gates(metafunc)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that uses a fixture of ours, so that -m bodycheck selects them."""
    for item in items:
        if {"bodycheck", "bodycheck_gate"} & set(getattr(item, "fixturenames", ())):
            item.add_marker("bodycheck")


@pytest.fixture
def bodycheck(request: pytest.FixtureRequest) -> Bench:
    """Run scenarios through engines, adapters or step functions, and check what was measured."""
    from bodycheck.pytest_plugin.fixtures import Bench

    return Bench.of(request)


@pytest.fixture
def bodycheck_gate(request: pytest.FixtureRequest) -> HeldGate:
    """Return one gate of the file that --bodycheck-tolerances names."""
    held: HeldGate = request.param
    return held.within(request)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print one line a check, from all workers."""
    lines = list(_checks(terminalreporter))
    if lines:
        terminalreporter.section("bodycheck")
        for line in lines:
            terminalreporter.write_line(line)


def _checks(terminalreporter: pytest.TerminalReporter) -> Iterator[str]:
    for reports in terminalreporter.stats.values():
        for report in reports:
            if getattr(report, "when", None) == "call":
                yield from (str(value) for name, value in report.user_properties if name == _PROPERTY)
