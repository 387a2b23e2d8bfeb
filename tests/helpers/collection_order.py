"""Selection and order of tests: the fast tier by default, and modules with slow tests first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import pytest

FAST = "not slow"
"""What runs where neither files nor markers are named."""

COLLECTED = pytest.StashKey[list[pytest.Item]]()
"""All tests of the files that were named, also those that do not run."""
_LEFT_OUT = pytest.StashKey[int]()


def pytest_configure(config: pytest.Config) -> None:
    """Select the fast tier if all tests would run; a named file or marker selects as usual."""
    runs_all = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if runs_all and not config.option.markexpr:
        config.option.markexpr = FAST


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect `nightly` and `engines` tests unless -m names them; put modules with `slow` tests first.

    Workers of pytest-xdist take modules in this order: a long one that starts last would run alone.
    """
    config.stash[COLLECTED] = [*items]
    _unmark_first_cases(items)
    for marker in ("nightly", "engines"):
        if marker not in config.option.markexpr:
            left_out = [item for item in items if item.get_closest_marker(marker)]
            items[:] = [item for item in items if not item.get_closest_marker(marker)]
            config.hook.pytest_deselected(items=left_out)
    if config.option.markexpr == FAST:
        config.stash[_LEFT_OUT] = sum(item.get_closest_marker("slow") is not None for item in items)
    long = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in long)


def _unmark_first_cases(items: Iterable[pytest.Item]) -> None:
    """Of a test marked `slow(after=N)` or `nightly(after=N)`, unmark the first N cases."""
    cases: Counter[str] = Counter()
    for item in items:
        function = item.nodeid.partition("[")[0]
        cases[function] += 1
        item.own_markers = [
            mark for mark in item.own_markers if cases[function] > mark.kwargs.get("after", 0)
        ]


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Tell the process that started this worker how many tests it left out."""
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["left_out"] = session.config.stash.get(_LEFT_OUT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Note how many tests a worker left out; each leaves out the same."""
    output = getattr(node, "workeroutput", {})
    node.config.stash[_LEFT_OUT] = output.get("left_out", node.config.stash.get(_LEFT_OUT, 0))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """End with the number of tests that were left out, and the commands that run them."""
    if left_out := config.stash.get(_LEFT_OUT, 0):
        terminalreporter.write_line(
            f"{left_out} slow tests were left out: python -m pytest -m slow runs them, "
            'python -m pytest -m "slow or not slow" all tests of a push'
        )
