"""JSON Schemas of the files and messages, made of the same definitions that read them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import metadata
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, create_model

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck.adapters.engine_names import ProgramsFile
from bodycheck.adapters.workers.received_messages import (
    AnnouncementMessage,
    AnswerMessage,
    BatchAnswerMessage,
    LapMessage,
    StableStepMessage,
)
from bodycheck.reports.gates.gate import ChangeThreshold, Gate, measure_names
from bodycheck.reports.measurement.case_columns import SCHEMA_VERSION
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.reports.run_files.run_reader import ManifestFile
from bodycheck.reports.run_files.tables import TABLES, column_type
from bodycheck.scenarios.fields import TomlTable
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import Sweep
from bodycheck.scenarios.tree_model import TreeScenario

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


@dataclass(frozen=True)
class Schema:
    """A JSON Schema with its version MAJOR.MINOR.

    MINOR rises if the schema accepts more, such as a new key; MAJOR if it refuses what it accepted.
    """

    name: str
    version: str
    summary: str
    made: Callable[[], dict[str, Any]]

    @cached_property
    def document(self) -> dict[str, Any]:
        """The schema with its address, its version and its title."""
        found = self.made()
        head = {"$schema": _DIALECT, "$id": address(self), "version": self.version, "title": self.summary}
        return {**head, **{key: value for key, value in found.items() if key not in ("title", "description")}}


def address(schema: Schema) -> str:
    """Return where the documentation has a schema: SITE/schemas/NAME-MAJOR.json."""
    found = (line.partition(", ") for line in metadata("bodycheck").get_all("Project-URL", ()))
    site = next((url for name, _, url in found if name == "Documentation"), "")
    return f"{site}/en/latest/schemas/{schema.name}-{schema.version.partition('.')[0]}.json"


def _scenario() -> dict[str, Any]:
    """Return the schema of a file with one body, or with a tree of bodies."""
    sweep: Any = (Annotated[tuple[Sweep, ...], Field(min_length=1, max_length=1)], Field(default=()))
    one = create_model("ScenarioFile", __base__=Scenario, sweep=sweep)
    tree = create_model("TreeFile", __base__=TreeScenario, sweep=sweep)
    files: Any = one | tree
    return TypeAdapter(files).json_schema()


def _tolerances(needed: str) -> dict[str, Any]:
    """Return the schema of a file of [[gate]] and [[change]] tables, which needs one of the two."""
    tables = {"gate": (tuple[Gate, ...], ()), "change": (tuple[ChangeThreshold, ...], ())}
    fields: Any = {**tables, needed: (Annotated[tables[needed][0], Field(min_length=1)], ...)}
    found = create_model("TolerancesFile", __base__=TomlTable, **fields).model_json_schema()
    found["$defs"]["Gate"]["properties"]["measure"]["enum"] = measure_names()
    return found


def _results() -> dict[str, Any]:
    """Return the schema of the rows of results.csv as `table RUN results --format json` prints them."""
    kind = TABLES["results"]
    columns: dict[str, dict[str, Any]] = {
        name: {"type": [column_type(name, kind), "null"]} for name in kind.columns
    }
    for name, words in kind.choices.items():
        columns[name]["enum"] = [*words]
    for measure in MEASURES.values():
        columns[measure.name]["description"] = measure.formula
    row = {
        "type": "object",
        "properties": columns,
        "required": [*kind.columns],
        "additionalProperties": False,
    }
    return {"type": "array", "items": row}


def _protocol() -> dict[str, Any]:
    """Return the schema of the messages of a worker; its other keys are ignored."""
    messages: Any = AnnouncementMessage | AnswerMessage | BatchAnswerMessage | LapMessage | StableStepMessage
    return TypeAdapter(messages).json_schema()


SCHEMAS: Mapping[str, Schema] = {
    schema.name: schema
    for schema in (
        Schema("scenario", "1.0", "A scenario file of bodycheck", _scenario),
        Schema("gates", "1.1", "A file of gates of bodycheck", lambda: _tolerances("gate")),
        Schema("thresholds", "1.1", "A file of thresholds of bodycheck", lambda: _tolerances("change")),
        Schema("engines", "1.0", "A file of programs for --engines", ProgramsFile.model_json_schema),
        Schema("manifest", "1.2", "manifest.json of a run", ManifestFile.model_json_schema),
        Schema("results", SCHEMA_VERSION, "The rows of results.csv, as JSON", _results),
        Schema("protocol", "1.0", "A message of a worker", _protocol),
    )
}


def schema_of(name: str) -> Schema:
    """Return the schema of that name; raises InputError for an unknown one."""
    if name not in SCHEMAS:
        raise InputError(f"{name}: no such schema{suggestion(name, SCHEMAS)}")
    return SCHEMAS[name]
