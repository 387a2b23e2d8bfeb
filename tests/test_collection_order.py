"""Which tests are selected, and the order in which they run."""

from __future__ import annotations

import pytest

pytest_plugins = ["pytester"]

MODULES = {
    "test_quick": "def test_quick(): pass",
    "test_the_others": """
        import pytest

        @pytest.mark.nightly
        def test_nightly(): pass

        @pytest.mark.slow
        def test_slow(): pass
        """,
}


@pytest.mark.parametrize(
    ("words", "run"),
    [
        ((), ["test_slow", "test_quick"]),
        (("-m", "not slow"), ["test_quick"]),
        (("-m", "nightly"), ["test_nightly"]),
        (("-m", "nightly or not nightly"), ["test_nightly", "test_slow", "test_quick"]),
    ],
)
def test_push_leaves_out_nightly_tests(
    words: tuple[str, ...], run: list[str], pytester: pytest.Pytester
) -> None:
    """Nightly tests run only if -m selects them, and modules with slow tests run first."""
    pytester.makeconftest("from tests.helpers.collection_order import pytest_collection_modifyitems")
    pytester.makepyfile(**MODULES)
    pytester.makeini("[pytest]\nmarkers =\n  slow\n  nightly\n")
    plugins = ("no:cacheprovider", "no:xdist", "no:hypothesispytest")
    done = pytester.runpytest_inprocess("-v", *(f"-p{plugin}" for plugin in plugins), *words)
    reported = [line.split("::")[1].split()[0] for line in done.outlines if line.endswith("%]")]
    assert reported == run
