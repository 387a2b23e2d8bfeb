"""The file of expected messages, and the comparison with them."""

from __future__ import annotations

import re

import pytest

from tests.helpers.collection_order import COLLECTED
from tests.helpers.expected_messages import FILE, matches, stored_messages


@pytest.mark.parametrize("file", stored_messages())
def test_every_message_belongs_to_a_test(file: str, request: pytest.FixtureRequest) -> None:
    """Each key is a test function of its file; parameters exist if all tests of the file are collected."""
    code = (FILE.parent / file).read_text(encoding="utf-8")
    collected = {item.name for item in request.config.stash[COLLECTED] if item.path == FILE.parent / file}
    whole = not request.config.option.keyword and not any("::" in word for word in request.config.args)
    for test in stored_messages()[file]:
        test = re.sub(r" \(\d+\)$", "", test)  # a later message of the same test
        function = f"test_{test.partition('[')[0]}"
        assert f"def {function}(" in code, test
        cases = {name for name in collected if name.partition("[")[0] == function}
        assert not (whole and cases) or "[" not in test or f"test_{test}" in cases, test


@pytest.mark.parametrize(
    ("found", "equal"),
    [
        ("a.obj: no such file", True),
        ("a.obj: not one such file", True),
        ("a.obj: no such file!", False),
        ("b.obj: no such file", False),
        ("a_obj: no such file", False),
        ("a.obj: no\nsuch file", False),
        ("a.obj: no such file\nand more", False),
        ("", False),
    ],
)
def test_only_the_expected_message_matches(found: str, equal: bool) -> None:
    """`...` matches any text on its line; everything else is compared character by character."""
    assert matches("a.obj: no...such file", found) == equal
