"""Where text goes: a terminal wraps, and has colour unless NO_COLOR is set; a pipe does neither."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

_ENDLESS = 10_000


def console() -> Console:
    """Return standard output; the lines of a pipe end where they end."""
    made = Console(highlight=False)
    if not made.is_terminal:
        made.width = _ENDLESS
    return made


def print_columns(
    out: Console, heads: Sequence[str], rows: Iterable[Sequence[str | Text]], right: Sequence[str] = ()
) -> None:
    """Print rows under their heads, if these say anything; of `right`, flush right. The last column wraps."""
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
