"""The pytest plugin: fixtures, a marker, options, a summary. Heavy imports wait until a fixture is used."""

from __future__ import annotations

from collections.abc import Iterator
from shutil import get_terminal_size
from textwrap import TextWrapper
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from bodycheck.pytest_plugin.fixtures import Bench, GateCase

_MARKER = "bodycheck(scenario, engine, method, dt_s): defaults of the fixture `bodycheck` in this test"
_PROPERTY = "bodycheck"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Register the command line options."""
    group = parser.getgroup("bodycheck", "accuracy of rigid-body engines")
    group.addoption(
        "--bodycheck-engines",
        metavar="NAME[:METHOD],...",
        help="engines or methods for tests whose bodycheck marker sets no engine: run each test once per "
        "method [default: none]",
    )
    group.addoption(
        "--bodycheck-suite",
        metavar="SCENARIO_OR_SUITE,...",
        help="scenarios for tests whose bodycheck marker sets no scenario: run each test once per scenario "
        "[default: none]; also the scenarios for gates [default: standard]",
    )
    group.addoption(
        "--bodycheck-gates",
        metavar="FILE",
        help="TOML file with the gates for tests that use bodycheck_gate: run each test once per gate; "
        "required by that fixture",
    )
    group.addoption(
        "--bodycheck-allow-code",
        action="store_true",
        help="let the file of gates name programs, cmd:COMMAND, that are started [default: it may not]",
    )
    group.addoption(
        "--bodycheck-report",
        metavar="DIR",
        help="keep each run, with its report, in DIR/TEST/RUN_ID [default: runs are not kept]",
    )
    group.addoption(
        "--bodycheck-reuse",
        action="store_true",
        help="let gates reuse results of earlier runs by the same build of an engine "
        "[default: run every case]",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker."""
    config.addinivalue_line("markers", _MARKER)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Parametrize marked tests over the scenarios and methods left open, and gate tests over the gates."""
    marked = "bodycheck" in metafunc.fixturenames and metafunc.definition.get_closest_marker("bodycheck")
    if not marked and "bodycheck_gate" not in metafunc.fixturenames:
        return
    from bodycheck.pytest_plugin import fixtures

    if marked:
        fixtures.parametrize_cases(metafunc)
    if "bodycheck_gate" in metafunc.fixturenames:
        fixtures.parametrize_gates(metafunc)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that uses one of the fixtures, so that -m bodycheck selects them."""
    for item in items:
        if {"bodycheck", "bodycheck_gate"} & set(getattr(item, "fixturenames", ())):
            item.add_marker("bodycheck")


@pytest.fixture
def bodycheck(request: pytest.FixtureRequest) -> Bench:
    """Run scenarios on engines, adapters or step functions, and check the measures."""
    from bodycheck.pytest_plugin.fixtures import Bench

    return Bench.of(request)


@pytest.fixture
def bodycheck_gate(request: pytest.FixtureRequest) -> GateCase:
    """Return one gate of the file that --bodycheck-gates names."""
    case: GateCase = request.param
    return case.within(request)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print each check, from all workers, in lines as wide as those of pytest."""
    lines = list(_checks(terminalreporter))
    if lines:
        terminalreporter.section("bodycheck")
        width = get_terminal_size().columns
        wrapper = TextWrapper(width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
        for line in lines:
            terminalreporter.write_line(wrapper.fill(line))


def _checks(terminalreporter: pytest.TerminalReporter) -> Iterator[str]:
    for reports in terminalreporter.stats.values():
        for report in reports:
            if getattr(report, "when", None) == "call":
                yield from (str(value) for name, value in report.user_properties if name == _PROPERTY)
