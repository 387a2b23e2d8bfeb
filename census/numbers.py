"""Published reference numbers and the certified truth of the same motion, digit by digit."""

from __future__ import annotations

import csv
import io
import math
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from decimal import Decimal
from functools import cache

from census.finding import HERE, INPUTS

NUMBERS, COMPARED = HERE / "numbers.toml", HERE / "numbers.csv"
HEADER = (
    "source",
    "case",
    "t, s",
    "quantity",
    "digits that agree",
    "published",
    "truth",
    "difference",
    "bound of the truth",
)


def compare_numbers() -> None:
    """Write numbers.csv: a row per published number, from `bodycheck truth` of the case."""
    rows = list(compared())
    with COMPARED.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(rows)
    for row in rows:
        print(*row, sep="  ")


def compared() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table."""
    cases = tomllib.loads(NUMBERS.read_text(encoding="utf-8"))
    for name, case in ((name, case) for name, of_name in cases.items() for case in of_name):
        truth = _truth(name, case["t_s"])
        bound = truth.get("bound_rad", truth.get("bound.rad", math.nan))
        for quantity, published in case["published"].items():
            found = _quantity(quantity, truth)
            difference = abs(Decimal(found) - Decimal(published))
            yield (
                case["source"], f"`{name}.toml`", str(case["t_s"]), quantity, digits(published, difference),
                published, repr(found), f"{difference:.1e}", f"{bound:.1e}",
            )  # fmt: skip


@cache
def _truth(name: str, t_s: float) -> dict[str, float]:
    """Return the row of `bodycheck truth` at a time."""
    command = ["truth", str(INPUTS / f"{name}.toml"), "--at", str(t_s), "--quiet"]
    done = subprocess.run(
        [sys.executable, "-m", "bodycheck", *command], capture_output=True, text=True, check=True
    )
    (row,) = csv.DictReader(io.StringIO(done.stdout))
    return {key: float(value) for key, value in row.items()}


def digits(published: str, difference: Decimal) -> str:
    """Return how many significant digits agree, as `9 of 9`, to half a unit of the last."""
    number = Decimal(published)
    stated = len(number.as_tuple().digits)
    if not difference:
        return f"{stated} of {stated}"
    agree = number.adjusted() - (2 * difference).adjusted()
    return f"{max(0, min(stated, agree))} of {stated}"


def _quantity(name: str, truth: dict[str, float]) -> float:
    """Return a column, or MRP of the attitude, degrees, sine and cosine of a joint, or a rate in degrees."""
    kind, _, part = name.partition("_")
    if kind == "degs":
        return math.degrees(truth[f"w{part}_body_rad_s"])
    if kind == "mrp":  # of the shorter set
        sign = math.copysign(1.0, truth["qw"])
        return sign * truth[f"q{part}"] / (1.0 + abs(truth["qw"]))
    if kind in ("sin", "cos", "deg"):
        return {"sin": math.sin, "cos": math.cos, "deg": math.degrees}[kind](truth[f"joint.{part}.q_rad"])
    return truth[name]
