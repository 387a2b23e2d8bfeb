"""The lists that `bodycheck list` prints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from ctypes.util import find_library
from dataclasses import dataclass

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.engine_names import Pin, is_named
from bodycheck.adapters.registry import default_engines, engine_names, optional_engines, stated_by
from bodycheck.adapters.versions.environments import installed_version, needed_environment, requirements_of
from bodycheck.adapters.workers.engine_pool import announced
from bodycheck.reference_impl.one_step_maps import formula_of
from bodycheck.reports.document import Column, Document, Sentence, Table
from bodycheck.reports.measurement.measures import MEASURES, SIGNED, Measure
from bodycheck.scenarios.library import scenario_summaries, suites, tree_summaries


@dataclass(frozen=True)
class CatalogueEntry:
    """One line of a list."""

    name: str
    description: str


def catalogue(kind: str, engines: Sequence[str] = (), match: str = "") -> list[CatalogueEntry]:
    """Return the scenarios, suites, engines, methods or measures.

    engines: those whose lines to return, as --engine names them [default: all]. match: text that a line has.
    Raises InputError for an unknown engine.
    """
    requested = tuple(dict.fromkeys(name.strip().partition(":")[0] for name in engines))
    if unknown := [name for name in requested if name not in engine_names()]:
        raise InputError(f"--engine {unknown[0]}: unknown engine{suggestion(unknown[0], engine_names())}")
    catalogues: dict[str, Callable[[], list[tuple[str, str]]]] = {
        "scenarios": lambda: [*scenario_summaries().items(), *_tree_rows()],
        "suites": lambda: [(name, ", ".join(members)) for name, members in suites().items()],
        "engines": lambda: _engine_rows(requested or engine_names()),
        "methods": lambda: [
            row
            for row in _method_rows(requested or engine_names())
            if is_named(tuple(name.strip() for name in engines), *row[0].split(":", 1))
        ],
        "measures": _measure_rows,
    }
    found = [CatalogueEntry(*row) for row in catalogues[kind]()]
    return [one for one in found if match.lower() in f"{one.name} {one.description}".lower()]


def catalogue_document(kind: str, entries: Sequence[CatalogueEntry]) -> Document:
    """Return one row per entry: its name and description."""
    if not entries:
        return Document(f"bodycheck: {kind}", (Sentence("none matches"),))
    rows = tuple((entry.name, entry.description) for entry in entries)
    return Document(f"bodycheck: {kind}", (Table((Column("", "fixed"), Column("")), rows),))


def _tree_rows() -> Iterator[tuple[str, str]]:
    """Yield the trees, which commands other than `dynamics` refuse."""
    for name, summary in tree_summaries().items():
        yield name, f"tree: {summary}"


def _measure_rows() -> list[tuple[str, str]]:
    return [(name, "; ".join(_stated(measure))) for name, measure in MEASURES.items()]


def _stated(measure: Measure) -> Iterator[str]:
    """Yield the formula, the column in SI units, and whether no verdict is given."""
    yield measure.formula
    if measure.unit:
        yield f"as {measure.name}_abs in {measure.unit}"
    if measure.signed:
        yield f"with the sign of the largest departure as {measure.name}{SIGNED}"
    if measure.judged is None:
        yield "not judged"


def _engine_rows(requested: Sequence[str]) -> list[tuple[str, str]]:
    rows = [
        (name, engine.version if isinstance(engine, Engine) else f"not available: {engine}")
        for name, engine in announced([name for name in default_engines() if name in requested]).items()
    ]
    return rows + [
        (name, f"on request (--engine {name}): {on_request_state(name)}")
        for name in optional_engines()
        if name in requested
    ]


def on_request_state(engine: str) -> str:
    """Return the version of an engine that runs on request and where it is, or what it needs."""
    stated = stated_by(engine)
    if library := getattr(stated, "system_library", ""):
        found = find_library(library)
        return f"{found}, of this system" if found else f"needs a shared library: {stated.install}"
    needed = needed_environment(engine)
    if found := installed_version(engine):
        return f"{found}, installed here" if needed is None else f"{found}, in its own environment"
    requirements = ", ".join(requirements_of(Pin(engine, None)))
    return f"needs {requirements}, which are installed into an environment when it is first requested"


def _method_rows(requested: Sequence[str]) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    on_request: list[tuple[str, str]] = []
    for name, engine in announced([name for name in default_engines() if name in requested]).items():
        for method in engine.methods.values() if isinstance(engine, Engine) else ():
            (on_request if method.on_request else rows).append(
                _method_row(name, method, on_request=method.on_request)
            )
    for name in optional_engines():
        if name in requested:
            stated = stated_by(name).methods.values()
            on_request += [_method_row(name, method, on_request=True) for method in stated]
    return rows + on_request


def _method_row(engine: str, method: Method, *, on_request: bool) -> tuple[str, str]:
    order = "" if method.order is None else f"; order {method.order}, torque {method.torque}"
    if method.continuous_loads != method.torque:
        order += f", varying loads {method.continuous_loads}"
    if method.precision != "float64":
        order += f"; precision {method.precision}"
    only = "; run only when requested by name" if on_request else ""
    if method.is_for_off_centre_links:
        only += ", or where a link is off the centre of mass"
    formula = formula_of(method.formula)
    return f"{engine}:{method.name}", f"{formula}{order}; conserves {method.conserves}{only}"
