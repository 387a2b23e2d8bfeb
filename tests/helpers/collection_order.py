"""Selection and order of tests: a push omits marked tests, and modules with slow tests come first."""

from __future__ import annotations

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect `nightly` and `engines` tests unless -m names them; put modules with `slow` tests first.

    Workers of pytest-xdist take modules in this order: a long one that starts last would run alone.
    """
    for marker in ("nightly", "engines"):
        if marker not in config.option.markexpr:
            left_out = [item for item in items if item.get_closest_marker(marker)]
            items[:] = [item for item in items if not item.get_closest_marker(marker)]
            config.hook.pytest_deselected(items=left_out)
    long = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in long)
