"""Which tests run when."""

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
def test_a_push_leaves_out_what_is_nightly(
    words: tuple[str, ...], run: list[str], pytester: pytest.Pytester
) -> None:
    """Only -m brings it in; the modules in which something is slow begin."""
    pytester.makeconftest("from tiers import pytest_collection_modifyitems")
    pytester.makepyfile(**MODULES)
    pytester.makeini("[pytest]\nmarkers =\n  slow\n  nightly\n")
    plugins = ("no:cacheprovider", "no:xdist", "no:hypothesispytest")
    done = pytester.runpytest_inprocess("-v", *(f"-p{plugin}" for plugin in plugins), *words)
    told = [line.split("::")[1].split()[0] for line in done.outlines if line.endswith("%]")]
    assert told == run
