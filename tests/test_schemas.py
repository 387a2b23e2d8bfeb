"""The JSON Schemas accept what the readers accept, and change only with their versions."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from bodycheck.adapters.contract import Build
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers import protocol
from bodycheck.reports.gates.gate import measure_names, measure_of
from bodycheck.runs.schemas import SCHEMAS
from tests.helpers.doc_pages import ROOT, blocks, pages
from tests.helpers.in_process_cli import run_bodycheck

jsonschema = pytest.importorskip("jsonschema")
STORED = Path(__file__).parent / "expected_schemas.json"
LIBRARY = sorted((ROOT / "bodycheck/scenarios/library").rglob("*.toml"))


def faults(name: str, data: Any) -> list[str]:
    """Return what a schema finds wrong with JSON data."""
    validator = jsonschema.Draft202012Validator(SCHEMAS[name].document)
    return [error.message for error in validator.iter_errors(json.loads(json.dumps(data)))]


@pytest.mark.parametrize("name", SCHEMAS)
def test_each_schema_is_a_schema_and_is_printed(name: str, tmp_path: Path) -> None:
    """The command prints valid JSON Schema with the version in its address."""
    printed = json.loads(run_bodycheck(tmp_path, "schema", name).stdout)
    jsonschema.Draft202012Validator.check_schema(printed)
    assert printed == json.loads(json.dumps(SCHEMAS[name].document))
    assert printed["$id"].endswith(f"/{name}-{printed['version'].partition('.')[0]}.json")


@pytest.mark.parametrize("file", LIBRARY, ids=lambda file: file.stem)
def test_library_is_accepted(file: Path) -> None:
    """Each scenario of the library is valid by the schema."""
    assert faults("scenario", tomllib.loads(file.read_text())) == []


def test_project_gates_and_pages_are_accepted() -> None:
    """The gates of the project, and the gates, thresholds and programs of the docs, are valid."""
    assert faults("gates", tomllib.loads((ROOT / "tolerances.toml").read_text())) == []
    shown = [tomllib.loads(block.text) for page in pages() for block in blocks(page, "toml")]
    for key, name in {"gate": "gates", "change": "thresholds", "engines": "engines"}.items():
        found = [data for data in shown if key in data]
        assert found
        assert [faults(name, data) for data in found] == [[]] * len(found)


PLATE: dict[str, Any] = {
    "name": "plate",
    "duration_s": 1.0,
    "samples": 11,
    "body": {"mass_kg": 2.0, "inertia_kg_m2": [1.0, 2.0, 3.0]},
}
GATE = {"measure": "energy_drift", "upper": 1e-6, "reason": "r"}
WRONG: dict[str, tuple[str, Any]] = {
    "an unknown key": ("scenario", {**PLATE, "gravity": 9.81}),
    "no duration": ("scenario", {key: value for key, value in PLATE.items() if key != "duration_s"}),
    "text for a number": ("scenario", {**PLATE, "duration_s": "1"}),
    "a vector of two": ("scenario", {**PLATE, "body": {"mass_kg": 1.0, "inertia_kg_m2": [1.0, 2.0]}}),
    "an unknown load": ("scenario", {**PLATE, "forcing": [{"kind": "wind"}]}),
    "an unknown shape": (
        "scenario",
        {**PLATE, "body": {"shape": "cone", "size_m": [1.0], "density_kg_m3": 1.0}},
    ),
    "an unknown measure": ("gates", {"gate": [{**GATE, "measure": "energy"}]}),
    "no reason": ("gates", {"gate": [{"measure": "energy_drift", "upper": 1.0}]}),
    "no gate": ("gates", {}),
    "an empty command": ("engines", {"engines": {"mine": {"command": []}}}),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_are_not_accepted(case: str) -> None:
    """The schemas find the mistakes that an editor can show."""
    name, data = WRONG[case]
    assert faults(name, data)


def test_the_cases_are_wrong_for_one_reason_only() -> None:
    """What the wrong files are made of is accepted, with a tensor and each of the other forms of a body."""
    tensor = {"mass_kg": 1.0, "inertia_kg_m2": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}
    shape = {"shape": "sphere", "size_m": [1.0], "density_kg_m3": 1.0}
    for body in (
        PLATE["body"],
        tensor,
        shape,
        {"mesh": "a.stl", "density_kg_m3": 1.0},
        {"urdf": "a.urdf", "link": "b"},
    ):
        assert faults("scenario", {**PLATE, "body": body}) == []
    drag = {"kind": "drag", "angular_n_m_s": 0.1}
    called = {"kind": "callable", "function": "module:f"}
    assert faults("scenario", {**PLATE, "forcing": [drag, called]}) == []
    assert faults("gates", {"gate": [GATE]}) == []


def test_measures_of_the_schema_are_those_of_gates() -> None:
    """Each name that an editor proposes is a measure of gates."""
    for name in measure_names():
        assert measure_of(name)


@pytest.mark.slow
def test_stored_runs_are_accepted(stored_run: Path) -> None:
    """The manifest of a run and the rows of its results, as `table` prints them, are valid."""
    assert faults("manifest", json.loads((stored_run / "manifest.json").read_text())) == []
    rows = json.loads(run_bodycheck(stored_run.parent, "table", "run", "results", "--format", "json").stdout)
    assert rows
    assert faults("results", rows) == []


def test_messages_of_workers_are_accepted() -> None:
    """An announcement and an answer in either notation of arrays are valid; text for an array is not."""
    announced = json.loads(protocol.line_of(protocol.announcement(Reference(), Build())))
    assert faults("protocol", announced) == []
    state = {"position": [0.0, 0.0, 0.0], "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}
    read_back = {"mass": 1.0, "inertia": [[1.0]], "dt_s": 0.01, "gravity": [0.0], "state": state}
    assert faults("protocol", {"trajectory": [state], "read_back": read_back}) == []
    assert faults("protocol", {"trajectory": [{"position": "here"}], "read_back": read_back})


def constraints(schema: Any, place: str = "") -> Iterator[str]:
    """Yield each constraint of a schema as one line, without titles, descriptions and defaults."""
    if isinstance(schema, dict):
        named = place.rsplit("/", 1)[-1] in ("properties", "$defs", "patternProperties")
        for key, value in schema.items():
            if named or key not in ("title", "description", "default", "version", "$id", "$schema"):
                yield from constraints(value, f"{place}/{key}")
                if not value and isinstance(value, dict):  # accepts anything
                    yield f"{place}/{key}"
    elif isinstance(schema, list):
        for value in schema:
            yield from constraints(value, f"{place}[]")
    else:
        yield f"{place} = {json.dumps(schema)}"


def changed(old: set[str], new: set[str]) -> str:
    """Return whether a schema refuses what it accepted (major), accepts more (minor), or neither."""
    needed = {line for line in new - old if "/required[] = " in line}
    if old - new or needed:
        return "major"
    return "minor" if new - old else ""


def check_version(name: str) -> None:
    """Compare a schema with the stored one: a change needs a higher version."""
    stored = json.loads(STORED.read_text())[name]
    schema = SCHEMAS[name]
    level = changed(set(stored["constraints"]), set(constraints(schema.document)))
    before, now = (tuple(map(int, version.split("."))) for version in (stored["version"], schema.version))
    assert not level or (now[0] > before[0] if level == "major" else now > before), (
        f"{name}: the schema changed ({level}): raise its version in bodycheck/runs/schemas.py, that of "
        "results in bodycheck/reports/measurement/case_columns.py, then run python -m tests.test_schemas"
    )


@pytest.mark.parametrize("name", SCHEMAS)
def test_schema_changes_only_with_its_version(name: str) -> None:
    """One that refuses what it accepted has a new major version, one that accepts more a minor one."""
    check_version(name)
    assert json.loads(STORED.read_text())[name]["version"] == SCHEMAS[name].version


def test_changes_are_recognised() -> None:
    """A new key is a minor change; a key that goes, a new required key and a tighter bound are major ones."""
    old = SCHEMAS["engines"].document
    lines = set(constraints(old))
    larger, smaller, needed, tighter = (deepcopy(old) for _ in range(4))
    program = larger["$defs"]["Program"]
    program["properties"]["folder"] = {"type": "string"}
    del smaller["$defs"]["Program"]["properties"]["environment"]
    needed["$defs"]["Program"]["required"].append("environment")
    tighter["$defs"]["Program"]["properties"]["command"]["minItems"] = 2
    found = [changed(lines, set(constraints(new))) for new in (old, larger, smaller, needed, tighter)]
    assert found == ["", "minor", "major", "major", "major"]


def store() -> None:
    """Store the present schemas as those that later ones are compared with, if their versions are right."""
    for name in json.loads(STORED.read_text()):
        check_version(name)
    found = {
        name: {"version": schema.version, "constraints": sorted(set(constraints(schema.document)))}
        for name, schema in SCHEMAS.items()
    }
    STORED.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    store()
