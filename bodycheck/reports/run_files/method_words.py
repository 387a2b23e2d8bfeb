"""The words of fingerprints.csv and laws.csv, and the columns of methods.csv that follow from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal, TypeAlias, get_args

NO_KNOWN_MAP = "no known map"
NOT_MEASURED = "not measured"

LawVerdict: TypeAlias = Literal["holds", "broken", "property", "not-measured"]
LAW_VERDICTS: tuple[LawVerdict, ...] = get_args(LawVerdict)

LawName: TypeAlias = Literal[
    "rotate",
    "permute",
    "link",
    "link-origin",
    "boost",
    "shift",
    "scale-mass",
    "scale-time",
    "reverse",
    "split",
    "repeat",
    "replay",
    "tree-rotate",
    "tree-boost",
    "tree-shift",
    "tree-order",
    "tree-flip",
    "tree-zero",
    "tree-divide",
    "tree-root",
    "tree-repeat",
]
LAW_NAMES: tuple[LawName, ...] = get_args(LawName)
"""In the order of `examine/probes/laws.py` and `tree_laws.py`, which have what each law requires."""
REPLAY: LawName = "replay"

SAME_BITS, OTHER_BITS = "same bits", "other bits"
_REPLAYS = {"holds": SAME_BITS, "property": OTHER_BITS, "not-measured": None}

_Row: TypeAlias = Mapping[str, Any]


def identified(
    method_rows: Iterable[_Row], fingerprints: Iterable[_Row], laws: Iterable[_Row]
) -> Iterator[dict[str, Any]]:
    """Yield rows of methods.csv with the known map of each method, and whether it gives the same bits again.

    fingerprints, laws: the rows of these tables.
    """
    maps = {_of(row): row["fingerprint"] for row in fingerprints}
    replays = {_of(row): _REPLAYS[row["verdict"]] for row in laws if row["law"] == REPLAY}
    for row in method_rows:
        key = _of(row)
        yield {**row, "fingerprint": maps.get(key), "replay": replays.get(key)}


def _of(row: _Row) -> tuple[str, str]:
    return row["engine"], row["method"]
