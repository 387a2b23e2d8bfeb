"""Write how to install and test an engine, and the tables of its methods, into the engines' pages.

python docs/method_tables.py: in docs/engines/ENGINE.md rewrites what is between the comments below, for each
engine, from what the adapters announce. tests/test_docs.py verifies that the pages are up to date.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from importlib.metadata import metadata
from pathlib import Path
from typing import TypeVar

from bodycheck.adapters.contract import Method
from bodycheck.adapters.registry import engine_names, get_adapter, stated_by
from bodycheck.reference_impl.one_step_maps import formula_of
from bodycheck.reports.document import markdown_table

ENGINES = Path(__file__).parent / "engines"
_UNPUBLISHED = " Nothing is published yet: in a checkout, `.` stands for `bodycheck`."
_Fact = TypeVar("_Fact", bound=Hashable)
_ENVIRONMENT = "the first run makes [an environment](../versions.md#the-environments) for it"
_INSTALL = {
    "mujoco": '`pip install bodycheck mujoco`, or `pip install "bodycheck[engines]"`',
    "pybullet": '`pip install bodycheck pybullet`, or `pip install "bodycheck[engines]"`',
    "dart": '`pip install bodycheck dartpy`, or `pip install "bodycheck[engines]"`',
    "reference": "nothing, it is part of bodycheck",
    "scipy": "nothing, bodycheck itself needs SciPy",
    "ode": "`apt install libode8`",
}


def with_tables(page: str, engine: str, methods: Iterable[Method]) -> str:
    """Return the page with its lines on the installation and its tables of methods replaced."""
    page = _replaced(page, "install", _installation(engine))
    return _replaced(page, "methods", _tables(list(methods)))


def _replaced(page: str, block: str, lines: Sequence[str]) -> str:
    begin, end = f"<!-- {block} -->", f"<!-- end of {block} -->"
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"no {begin} ... {end} in the page")
    return "\n".join([f"{before}{begin}", *lines, f"{end}{after}"])


def _installation(engine: str) -> list[str]:
    install = _INSTALL.get(engine)
    if install is None and engine in metadata("bodycheck").get_all("Provides-Extra", ()):
        install = f'`pip install "bodycheck[{engine}]"`, or nothing: {_ENVIRONMENT}'
    elif install is None:
        install = f"Node.js and npm; {_ENVIRONMENT}"
    scenario = "intermediate-axis" if engine in ("mujoco", "pybullet", "dart", "reference") else "quick"
    return [
        f"- [Install](../start.md#install): {install}.{_UNPUBLISHED * ('pip' in install)}",
        f"- Test: `bodycheck run {scenario} --engine {engine}`.",
    ]


def _tables(methods: list[Method]) -> list[str]:
    head = ("method", "order", "precision", "conserves", "loads evaluated")
    alike = _alike(
        methods,
        lambda one: (
            "" if one.order is None else str(one.order),
            one.precision,
            one.conserves,
            one.continuous_loads,
        ),
    )
    maps = _alike(methods, lambda one: f"`{formula_of(one.formula)}`")
    sources = _alike(methods, lambda one: one.source)
    defaults = _alike(methods, lambda one: "; ".join(one.changed_defaults) or "none")
    return [
        "## Methods",
        "",
        *markdown_table(head, [(names, *facts) for facts, names in alike.items()]),
        *_listed("One-step maps", maps),
        *_listed("Sources", sources),
        *_listed("Changed defaults", defaults),
    ]


def _alike(methods: list[Method], fact: Callable[[Method], _Fact]) -> dict[_Fact, str]:
    """Return each fact with the names of the methods that share it, "all" for several that are all."""
    names: dict[_Fact, list[str]] = {}
    for method in methods:
        names.setdefault(fact(method), []).append(method.name)
    return {
        one: "all" if len(found) == len(methods) > 1 else f"`{', '.join(found)}`"
        for one, found in names.items()
    }


def _listed(title: str, facts: dict[str, str]) -> list[str]:
    return ["", f"{title}:", "", *(f"- {names}: {fact}" for fact, names in facts.items())]


def main() -> None:
    """Rewrite the page of each engine."""
    for name in engine_names():
        path = ENGINES / f"{name}.md"
        if path.exists():
            page = path.read_text(encoding="utf-8")
            adapter = stated_by(name) or get_adapter(
                name
            )  # the facts of an optional one do not need its engine
            path.write_text(with_tables(page, name, adapter.methods.values()), encoding="utf-8")


if __name__ == "__main__":
    main()
