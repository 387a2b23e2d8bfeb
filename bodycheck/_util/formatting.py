"""Format numbers, lists and tables as text, for a terminal, a pipe or Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, JustifyMethod
    from rich.text import Text

_MOST_NAMES = 8


def number(value: float | None, digits: int = 4) -> str:
    """Return value with so many significant digits, without trailing zeros; "" for None or NaN."""
    if value is None or value != value:
        return ""
    return _short_exponent(f"{value:.{digits}g}")


def scientific(value: float) -> str:
    """Return value as 2.78e-2, or as 0.315 or 2.78 near 1."""
    return number(value, 3) if 0.1 <= value < 1000.0 else _short_exponent(f"{value:.2e}")


def _short_exponent(text: str) -> str:
    return re.sub(r"e([+-])0*(\d)", r"e\1\2", text).replace("e+", "e") if "e" in text else text


def step(dt_s: float | None) -> str:
    """Return a step with all digits, so that it parses to the same double; "" for None."""
    return "" if dt_s is None else _short_exponent(repr(dt_s))


def setting(control: str | None, fineness: float | None) -> str:
    """Return "dt 0.01 s", "tolerance 1e-6", or "no steps"."""
    if fineness is None:
        return "no steps"
    return f"dt {step(fineness)} s" if control == "dt" else f"tolerance {step(fineness)}"


def vector(values: Iterable[float]) -> str:
    """Return "(x, y, z)", each with 6 digits."""
    return f"({', '.join(number(value, 6) for value in values)})"


def names(words: Sequence[str]) -> str:
    """Return "a, b and c"; a long list ends with the number of further items."""
    if len(words) > _MOST_NAMES:
        words = [*words[: _MOST_NAMES - 1], f"{len(words) - _MOST_NAMES + 1} more"]
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def count(amount: int, thing: str) -> str:
    """Return "1 case", "2 cases"."""
    return f"{amount} {thing}" if amount == 1 else f"{amount} {thing}s"


_ENDLESS = 10_000


def console() -> Console:
    """Return a console on standard output; it does not wrap lines in a pipe."""
    from rich.console import Console  # late: numbers are formatted where nothing is printed

    made = Console(highlight=False)
    if not made.is_terminal:
        made.width = _ENDLESS
    return made


def print_columns(
    out: Console, heads: Sequence[str], rows: Iterable[Sequence[str | Text]], right: Sequence[str] = ()
) -> None:
    """Print rows under their heads, if any is not empty; right-align `right`; wrap the last column."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold", show_header=any(heads))
    for place, head in enumerate(heads):
        last = place == len(heads) - 1
        justify: JustifyMethod = "right" if head in right else "left"
        table.add_column(head, justify=justify, no_wrap=not last, overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    with out.capture() as shown:
        out.print(table)
    for line in shown.get().splitlines():
        print(line.rstrip(), file=out.file)


def markdown_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table; what stands in a cell cannot end it."""
    lines = [heads, ["---"] * len(heads), *rows]
    return [f"| {' | '.join(escaped_markdown(cell) for cell in line)} |" for line in lines]


def escaped_markdown(text: str) -> str:
    """Return text that Markdown shows as it stands, in one line: no table, tag or mention begins in it."""
    plain = " ".join(text.split())
    if plain.startswith("`") and plain.endswith("`") and "`" not in plain[1:-1]:
        return plain.replace("|", "\\|")
    return re.sub(r"[\\|<*`\[@]|(?<!\w)_|_(?!\w)", r"\\\g<0>", plain)
