"""Write the tables of methods into the engines' pages, from what the adapters announce.

python docs/method_tables.py: in docs/engines/ENGINE.md rewrites what is between the two comments below,
for each engine. tests/test_docs.py verifies that the pages are up to date.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bodycheck.adapters.contract import Method
from bodycheck.adapters.registry import engine_names, get_adapter, stated_by
from bodycheck.reference_impl.one_step_maps import formula_of
from bodycheck.reports.document import markdown_table

ENGINES = Path(__file__).parent / "engines"
BEGIN, END = "<!-- methods -->", "<!-- end of methods -->"


def with_tables(page: str, methods: Iterable[Method]) -> str:
    """Return the page with its table of methods and its list of changed defaults replaced."""
    before, _, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"no {BEGIN} ... {END} in the page")
    return f"{before}{BEGIN}\n{_tables(list(methods))}\n{END}{after}"


def _tables(methods: list[Method]) -> str:
    alike: dict[tuple[str, ...], list[str]] = {}
    changed: dict[tuple[str, ...], list[str]] = {}
    for method in methods:
        order = "" if method.order is None else str(method.order)
        facts = (
            f"`{formula_of(method.formula)}`",
            order,
            method.precision,
            method.conserves,
            method.continuous_loads,
            method.source,
        )
        alike.setdefault(facts, []).append(method.name)
        changed.setdefault(method.changed_defaults, []).append(method.name)
    head = ("method", "map", "order", "precision", "conserves", "loads evaluated", "source")
    table = markdown_table(head, [(f"`{', '.join(names)}`", *facts) for facts, names in alike.items()])
    defaults = [f"- `{', '.join(names)}`: {'; '.join(facts) or 'none'}" for facts, names in changed.items()]
    return "\n".join([*table, "", "Changed defaults:", "", *defaults])


def main() -> None:
    """Rewrite the page of each engine."""
    for name in engine_names():
        path = ENGINES / f"{name}.md"
        if path.exists():
            page = path.read_text(encoding="utf-8")
            adapter = stated_by(name) or get_adapter(
                name
            )  # the facts of an optional one do not need its engine
            path.write_text(with_tables(page, adapter.methods.values()), encoding="utf-8")


if __name__ == "__main__":
    main()
