"""The lists that `bodycheck list` prints."""

from __future__ import annotations

from collections.abc import Callable

from rich.console import Console
from rich.text import Text

from bodycheck.adapters.contract import Engine
from bodycheck.adapters.registry import engine_names
from bodycheck.adapters.workers.engine_pool import announced
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.scenarios.library import scenario_summaries, suites


def print_catalogue(what: str) -> None:
    """Print one line per entry: its name and description."""
    out = Console(highlight=False, soft_wrap=True)
    catalogues: dict[str, Callable[[], list[tuple[str, str]]]] = {
        "scenarios": lambda: list(scenario_summaries().items()),
        "suites": lambda: [(name, ", ".join(members)) for name, members in suites().items()],
        "engines": _engine_rows,
        "methods": _method_rows,
        "measures": _measure_rows,
    }
    rows = catalogues[what]()
    width = max(len(name) for name, _ in rows)
    for name, text in rows:
        out.print(Text(f"{name:{width}}  {text}"))


def _measure_rows() -> list[tuple[str, str]]:
    return [
        (name, measure.formula + (f"; as {name}_abs in {measure.unit}" if measure.unit else ""))
        for name, measure in MEASURES.items()
    ]


def _engine_rows() -> list[tuple[str, str]]:
    return [
        (name, engine.version if isinstance(engine, Engine) else f"not available: {engine}")
        for name, engine in announced(engine_names()).items()
    ]


def _method_rows() -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    apart: list[tuple[str, str]] = []
    for name, engine in announced(engine_names()).items():
        for method in engine.methods.values() if isinstance(engine, Engine) else ():
            order = "" if method.order is None else f"; order {method.order}, torque {method.torque}"
            if method.lasting != method.torque:
                order += f", varying loads {method.lasting}"
            only = "; run only when requested by name" if method.on_request else ""
            if method.is_for_off_centre_links:
                only += ", or where a link is off the centre of mass"
            row = (f"{name}:{method.name}", f"{method.formula}{order}; conserves {method.keeps}{only}")
            (apart if method.on_request else rows).append(row)
    return rows + apart
