"""Nightly runs are compared on machines that are alike: in processor, cores, system and architecture."""

from __future__ import annotations

from typing import Any

import pytest

from bodycheck.reports.history.baseline import machine_class

MANIFEST: dict[str, Any] = {
    "cpu": "a processor",
    "cores": 4,
    "system": "Linux x86_64",
    "platform": "Linux-6.1",
    "python": "3.12.1",
    "libraries": {"numpy": "2.4.6"},
    "engines": {},
}


@pytest.mark.parametrize("changed", [{"cpu": "another"}, {"cores": 8}, {"system": "Linux aarch64"}])
def test_another_machine_is_of_another_class(changed: dict[str, Any]) -> None:
    """Each of the three by itself: a speed on twice the cores is not the speed of the same machine."""
    assert machine_class({**MANIFEST, **changed}) != machine_class(MANIFEST)


@pytest.mark.parametrize(
    "changed", [{"platform": "Linux-6.2"}, {"python": "3.13.0"}, {"libraries": {}}, {"engines": {"a": {}}}]
)
def test_a_machine_with_other_software_is_of_the_same_class(changed: dict[str, Any]) -> None:
    """What an update changes is to be seen, not kept apart."""
    assert machine_class({**MANIFEST, **changed}) == machine_class(MANIFEST)
