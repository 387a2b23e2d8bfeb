"""Messages that tests compare word for word, in one file, so that a change of wording changes one line.

`pytest --update-messages` writes the messages of the tests that it runs. `...` stands for any text, such as
the words of a library: shorten a message by hand if another version may phrase it differently. If all
parameters of a test give one message, store it by hand under the test's name alone, with {NAME} for a
parameter's value.
"""

from __future__ import annotations

import fcntl
import json
import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import pytest

FILE = Path(__file__).parents[1] / "expected_messages.toml"
_HEADER = "# What tests expect of messages; `pytest --update-messages TEST` writes it, `...` is any text.\n"
Messages = dict[str, dict[str, str | list[str]]]
"""Test file below tests/ -> test, with or without its parameters -> its message, or the message's lines."""


class ExpectedMessage:
    """The expected messages of one test, in order: call it with each message that the test got."""

    def __init__(self, request: pytest.FixtureRequest) -> None:
        self._file = request.path.relative_to(FILE.parent).as_posix()
        self._name = request.node.name.removeprefix("test_")
        self._parameters = request.node.callspec.params if hasattr(request.node, "callspec") else {}
        self._calls = 0
        self._arguments = request.node.funcargs
        self._update = bool(request.config.getoption("--update-messages"))

    def __call__(self, message: str, folder: Path | None = None) -> None:
        """Compare a message with the stored one; raise AssertionError if they differ.

        folder: the folder whose path FOLDER replaces in the message, by default the test's temporary one.
        """
        self._calls += 1
        folder = folder or self._arguments.get("tmp_path")
        found = message if folder is None else message.replace(str(folder), "FOLDER")
        if not matches(expected := self._stored(), found):
            assert self._update, (
                f"expected: {expected}\nfound: {found}\nin {FILE.name}: {self._test}\n"
                f"if the change is intended: pytest --update-messages tests/{self._file}"
            )
            _store(self._file, self._test, found)

    @contextmanager
    def raises(self, *errors: type[Exception]) -> Iterator[pytest.ExceptionInfo[Exception]]:
        """Expect one of the errors, with the message that is stored for this test."""
        with pytest.raises(errors) as caught:
            yield caught
        self(str(caught.value))

    @property
    def _test(self) -> str:
        name, number = self._name.partition("[")[0], f" ({self._calls})" if self._calls > 1 else ""
        shared = f"{name}{number}"
        return shared if shared in stored_messages().get(self._file, {}) else f"{self._name}{number}"

    def _stored(self) -> str:
        stored = stored_messages().get(self._file, {}).get(self._test, "")
        text = stored if isinstance(stored, str) else "\n".join(stored)
        for name, value in self._parameters.items():
            text = text.replace(f"{{{name}}}", str(value))
        return text


def matches(expected: str, found: str) -> bool:
    """Return whether a message is the expected one, in which `...` stands for any text on its line."""
    return re.fullmatch(".*".join(map(re.escape, expected.split("..."))), found) is not None


def stored_messages() -> Messages:
    """Return all expected messages."""
    with FILE.open(encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        return _parsed(file.read())


@lru_cache(maxsize=1)
def _parsed(text: str) -> Messages:
    return tomllib.loads(text)


def _store(name: str, test: str, message: str) -> None:
    lines = message.splitlines()
    with FILE.open("r+", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # tests run in several processes
        messages = tomllib.loads(file.read())
        messages.setdefault(name, {})[test] = lines if len(lines) > 1 else message
        file.seek(0)
        file.write(_toml(messages))
        file.truncate()


def _toml(messages: Messages) -> str:
    tables = (
        "\n".join([f"[{_quoted(file)}]", *(f"{_quoted(test)} = {_value(of[test])}" for test in sorted(of))])
        for file, of in sorted(messages.items())
    )
    return f"{_HEADER}\n" + "\n\n".join(tables) + "\n"


def _value(message: str | list[str]) -> str:
    if isinstance(message, str):
        return _quoted(message)
    return "".join(["[\n", *(f"    {_quoted(line)},\n" for line in message), "]"])


def _quoted(text: str) -> str:
    """Return a JSON string, which is also a TOML string if it has no control characters."""
    return json.dumps(text, ensure_ascii=False)
