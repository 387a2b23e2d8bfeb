"""Every contender of the benchmark solves the free body."""

from __future__ import annotations

import pytest

from benchmarks.contenders import HEYOKA, all_contenders
from benchmarks.problems import FREE
from benchmarks.solver import tried


@pytest.mark.nightly
def test_each_contender_meets_a_microradian() -> None:
    """Tried from the cheapest on, some setting meets it; a contender that cannot run here has a reason."""
    contenders, missing = all_contenders()
    for contender in contenders:
        assert tried(contender, FREE, 1e-6)[-1].error <= 1e-6, contender.name
    assert {one.name for one in contenders} | set(missing) >= {
        HEYOKA,
        "MuJoCo rk4",
        "closed form",
    }
    assert all(missing.values())
