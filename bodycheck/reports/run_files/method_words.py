"""The words of fingerprints.csv and laws.csv, and the columns of methods.csv that follow from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal, TypeAlias, get_args

NO_KNOWN_MAP = "no known map"
NOT_MEASURED = "not measured"

_MAPS_IN_WORDS = {
    "M1": "semi-implicit Euler",
    "M1, pose from the old omega": "explicit Euler",
    "M1d": "semi-implicit Euler with implicit dampers",
    "M2": "linearly implicit Euler",
    "M2s": "semi-implicit Euler with implicit dampers and springs",
    "M3": "linearly implicit gyroscopic term",
}
"""Label of known maps -> the same in words."""


def map_in_words(name: str) -> str:
    """Return the name of a known map in words, such as "semi-implicit Euler, additive matrix (M1)"."""
    labels = [label for label in _MAPS_IN_WORDS if f"{name},".startswith(f"{label},")]
    if not labels:
        return name
    label = max(labels, key=len)
    return f"{_MAPS_IN_WORDS[label]}{name.removeprefix(label)} ({label})"


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
