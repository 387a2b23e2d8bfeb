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
from bodycheck.reference_impl.one_step_maps import named_map
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.measurement.measures import MEASURES, SIGNED, Measure
from bodycheck.reports.table_layout import Column
from bodycheck.scenarios.library import scenario_summaries, suites, tree_summaries


@dataclass(frozen=True)
class CatalogueEntry:
    """One line of a list.

    map, formula: of a method that makes a known map; on_request: whether only its name requests it.
    """

    name: str
    description: str
    map: str = ""
    formula: str = ""
    on_request: bool = False


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
        "measures": _measure_rows,
    }
    if kind == "methods":
        wanted = tuple(name.strip() for name in engines)
        entries = _methods(requested or engine_names())
        found = [one for one in entries if is_named(wanted, *one.name.split(":", 1))]
    else:
        found = [CatalogueEntry(*row) for row in catalogues[kind]()]
    return [one for one in found if match.lower() in f"{one.name} {one.description} {one.formula}".lower()]


def catalogue_document(kind: str, entries: Sequence[CatalogueEntry]) -> Document:
    """Return one row per entry: its name, and its description or which entry has the same; maps once."""
    if not entries:
        return Document(f"bodycheck: {kind}", (Sentence("none matches"),))
    first: dict[str, str] = {}
    rows: dict[bool, list[tuple[str, str]]] = {False: [], True: []}
    for one in entries:
        same = first.setdefault(one.description, one.name)
        rows[one.on_request].append((one.name, one.description if same == one.name else f"as {same}"))
    maps = {one.map: one.formula for one in entries if one.map}
    columns = (Column("", "fixed"), Column(""))
    return Document(
        f"bodycheck: {kind}",
        (
            Table(columns, tuple(rows[False])),
            Table(columns, tuple(rows[True]), "Only when requested by name"),
            Table((Column("", "name"), Column("")), tuple(maps.items()), "Maps"),
        ),
    )


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
    return f"needs {requirements}, installed into an environment at the first request"


def _methods(requested: Sequence[str]) -> list[CatalogueEntry]:
    found = [
        _method(name, method, on_request=method.on_request)
        for name, engine in announced([name for name in default_engines() if name in requested]).items()
        for method in (engine.methods.values() if isinstance(engine, Engine) else ())
    ]
    found += [
        _method(name, method, on_request=True)
        for name in optional_engines()
        if name in requested
        for method in stated_by(name).methods.values()
    ]
    return sorted(found, key=lambda one: one.on_request)


def _method(engine: str, method: Method, *, on_request: bool) -> CatalogueEntry:
    order = "" if method.order is None else f"; order {method.order}, torque {method.torque}"
    if method.continuous_loads != method.torque:
        order += f", varying loads {method.continuous_loads}"
    if method.precision != "float64":
        order += f"; precision {method.precision}"
    also = "; also run where a link is off the centre of mass" if method.is_for_off_centre_links else ""
    name = method.formula.partition("; ")[0]
    known = named_map(name)
    return CatalogueEntry(
        f"{engine}:{method.name}",
        f"{method.formula}{order}; conserves {method.conserves}{also}",
        name if known else "",
        known[0].description if known else "",
        on_request,
    )
