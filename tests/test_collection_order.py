"""Which tests are selected, and the order in which they run."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

MODULES = {
    "test_quick": "def test_quick(): pass",
    "test_the_others": """
        import pytest

        @pytest.mark.nightly
        def test_nightly(): pass

        @pytest.mark.nightly(after=1)
        @pytest.mark.parametrize("case", "abc")
        def test_cases(case): pass

        @pytest.mark.slow
        def test_slow(): pass
        """,
}
CASES = ["test_cases[a]", "test_cases[b]", "test_cases[c]"]

HOOKS = """
from tests.helpers.collection_order import (
    pytest_collection_modifyitems, pytest_configure, pytest_sessionfinish, pytest_terminal_summary,
    pytest_testnodedown,
)
"""
PLUGINS = ("no:cacheprovider", "no:hypothesispytest")


@pytest.fixture
def project(pytester: pytest.Pytester) -> pytest.Pytester:
    """Return a project of two modules, whose tests lie in the folder of the settings."""
    pytester.makeconftest(HOOKS)
    pytester.makepyfile(**MODULES)
    pytester.makeini("[pytest]\ntestpaths = .\nmarkers =\n  slow\n  nightly\n  engines\n")
    return pytester


@pytest.mark.parametrize(
    ("words", "run"),
    [
        ((), ["test_cases[a]", "test_quick"]),
        (("-m", "slow"), ["test_slow"]),
        (("-m", "slow or not slow"), ["test_cases[a]", "test_slow", "test_quick"]),
        (("test_the_others.py", "test_quick.py"), ["test_cases[a]", "test_slow", "test_quick"]),
        (("test_the_others.py::test_slow",), ["test_slow"]),
        (("-m", "not slow"), ["test_cases[a]", "test_quick"]),
        (("-m", "nightly"), ["test_nightly", *CASES[1:]]),
        (("-m", "nightly or not nightly"), ["test_nightly", *CASES, "test_slow", "test_quick"]),
    ],
)
def test_fast_tests_run_unless_others_are_named(
    words: tuple[str, ...], run: list[str], project: pytest.Pytester
) -> None:
    """A file runs with its slow tests, nightly tests run only by their marker, slow modules run first.

    Of a test that is nightly after its first case, that case is an ordinary test.
    """
    done = project.runpytest_inprocess("-v", "-pno:xdist", *(f"-p{plugin}" for plugin in PLUGINS), *words)
    reported = [line.split("::")[1].split()[0] for line in done.outlines if line.endswith("%]")]
    assert reported == run


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("processes", ["0", "2"])
def test_the_session_ends_with_what_it_left_out(
    processes: str, project: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last lines have the number of slow tests and the commands that run them, also with workers."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    words = ("-n", processes, *(f"-p{plugin}" for plugin in PLUGINS))
    done = project.runpytest_subprocess(*words)
    (line,) = [line for line in done.outlines if "left out" in line]
    assert line.startswith("1 slow tests were left out: python -m pytest -m slow runs them")
    assert not any("left out" in line for line in project.runpytest_subprocess(*words, "-m", "slow").outlines)
