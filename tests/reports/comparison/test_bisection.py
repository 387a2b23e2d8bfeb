"""The search for changes in an ordered list, compared with an evaluation of every member."""

from __future__ import annotations

import math
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from bodycheck.reports.comparison.release_results import changes, every_change

# how long each value stays, and which members cannot be measured
stretches = st.lists(st.integers(1, 12), min_size=1, max_size=5)
failing = st.sets(st.integers(0, 40), max_size=12)


class Measured:
    """Members whose values come in stretches, each value once; some cannot be measured."""

    def __init__(self, lengths: list[int], failing: set[int]) -> None:
        self.values = [value for value, length in enumerate(lengths) for _ in range(length)]
        self.members = [str(place) for place in range(len(self.values))]
        self.failing = failing
        self.requested: list[str] = []

    def __call__(self, member: str) -> int | None:
        """Return the value; None of one that fails."""
        self.requested.append(member)
        return None if int(member) in self.failing else self.values[int(member)]

    @property
    def sound(self) -> list[int]:
        """The places that can be measured."""
        return [place for place in range(len(self.values)) if place not in self.failing]


@given(stretches, failing)
def test_every_change_between_the_ends_is_found(lengths: list[int], failing: set[int]) -> None:
    """The pairs are the differing neighbours among the measurable members; no member is measured twice."""
    measured = Measured(lengths, failing)
    found = changes(measured.members, measured, lambda one, other: one != other)
    neighbours = zip(measured.sound, measured.sound[1:], strict=False)
    there = [(str(a), str(b)) for a, b in neighbours if measured.values[a] != measured.values[b]]
    assert list(found) == there
    assert len(measured.requested) == len(set(measured.requested))


@given(stretches, failing)
def test_few_members_are_measured(lengths: list[int], failing: set[int]) -> None:
    """The ends, log2(n) per change, and at most all members that cannot be measured."""
    measured = Measured(lengths, failing)
    found = changes(measured.members, measured, lambda one, other: one != other)
    halves = math.ceil(math.log2(max(2, len(measured.members))))
    failed = len(measured.members) - len(measured.sound)
    assert len(measured.requested) <= 2 + len(found) * halves + failed


@given(st.lists(st.integers(0, 2), max_size=20))
def test_pair_consists_of_differing_neighbours(values: list[int]) -> None:
    """Whatever the values, a pair is of neighbours that differ; equal ends give no pair."""
    members = [str(place) for place in range(len(values))]
    found = changes(members, lambda member: values[int(member)], lambda one, other: one != other)
    for before, after in found:
        assert int(after) == int(before) + 1
        assert values[int(before)] != values[int(after)]
    assert bool(found) == bool(values and values[0] != values[-1])


@given(st.lists(st.one_of(st.none(), st.integers(0, 2)), max_size=20))
def test_measuring_every_member_finds_every_change(values: list[int | None]) -> None:
    """Changes between equal ends are found; unmeasurable members are skipped."""
    members = [str(place) for place in range(len(values))]
    requested: list[str] = []

    def measured(member: str) -> int | None:
        requested.append(member)
        return values[int(member)]

    found = every_change(members, measured, lambda one, other: one != other)
    sound = [place for place, value in enumerate(values) if value is not None]
    neighbours = pairwise(sound)
    assert list(found) == [(str(a), str(b)) for a, b in neighbours if values[a] != values[b]]
    assert requested == members


def test_small_differences_add_up() -> None:
    """Each member is compared with the first one since the last change."""
    values = {str(k): 1.0 + 0.4 * k for k in range(7)}
    found = every_change(list(values), values.get, lambda one, other: abs(one - other) > 1.0)
    assert found == (("2", "3"), ("5", "6"))
