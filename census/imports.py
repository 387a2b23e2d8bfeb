"""What each importer makes of each link and joint of published models, as counts."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from bodycheck.audit.audit import Audit
from census.csv_rows import read_rows
from census.finding import HERE

IMPORTS = HERE / "imports.csv"
WHAT = ("file", "link", "joint")
_ISSUE = re.compile(r" \([\w.-]+/[\w.-]+#\d+\)")
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?")
_QUOTED = re.compile(r" '[^']*'|(Element| element|; its last output).*", re.DOTALL)
_LONGEST = 100


@dataclass(frozen=True)
class ImportCount:
    """How many files, links or joints of a package an importer holds in a state, of those with a cause.

    The rows without a cause count all in that state; one link or joint may have several causes.
    """

    package: str
    version: str
    importer: str
    release: str
    what: str
    state: str
    cause: str
    count: int
    files: int


def read_imports() -> list[ImportCount]:
    """Return the rows of imports.csv."""
    return read_rows(IMPORTS, ImportCount)


def counted(package: str, version: str, audits: Iterable[Audit]) -> list[ImportCount]:
    """Return the counts of a package, ordered by importer, files before links before joints."""
    files: dict[tuple[str, str, str, str, str], list[str]] = defaultdict(list)
    for audit in audits:
        for key in _facts(audit):
            files[key].append(audit.file)
    rows = [
        ImportCount(package, version, importer, release, what, state, cause, len(in_), len(set(in_)))
        for (importer, release, what, state, cause), in_ in files.items()
    ]
    return sorted(
        rows,
        key=lambda one: (
            one.importer,
            WHAT.index(one.what),
            one.state,
            one.cause != "",
            -one.count,
            one.cause,
        ),
    )


def _facts(audit: Audit) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield importer, release, what, state and cause of each file, link and joint."""
    releases = {column.name: column.version for column in audit.columns}
    for column in audit.columns:
        if column.outcome == "unsupported":
            continue
        state = "read" if column.outcome == "ok" else "not read"
        yield column.name, column.version, "file", state, ""
        if state != "read":
            yield (
                column.name,
                column.version,
                "file",
                state,
                kind_of_message(column.message or column.outcome),
            )
    for what, parts in (("link", audit.links), ("joint", audit.joints)):
        for part in parts:
            for name, held in part.held.items():
                for cause in ("", *sorted({kind_of_cause(one) for one in held.causes})):
                    yield name, releases[name], what, held.state, cause


def kind_of_cause(cause: str) -> str:
    """Return a cause without the numbers and names of its link."""
    return _NUMBER.sub("N", _ISSUE.sub("", cause)).partition(":")[0]


def kind_of_message(message: str) -> str:
    """Return a message without what is quoted, numbers and places."""
    return _NUMBER.sub("N", _QUOTED.sub("", message))[:_LONGEST].strip()
