"""The commands that set up a project: gates with a workflow, and JSON Schemas for editors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.options import PROJECT, Json, complete_engines, described

project_commands = typer.Typer()


def _complete_schemas(incomplete: str) -> list[tuple[str, str]]:
    from bodycheck.runs.schemas import SCHEMAS

    return [(one.name, one.summary) for one in SCHEMAS.values() if one.name.startswith(incomplete)]


@project_commands.command(
    short_help="Write gates and a workflow for a project.",
    **described(
        PROJECT,
        "bodycheck init --engine mujoco:rk4",
        "bodycheck init my-engine --engine cmd:build/engine",
    ),
)
def init(
    folder: Annotated[Path, typer.Argument(help="Folder of the project.")] = Path(),
    engine: Annotated[
        str,
        typer.Option(
            help="The engine to check: NAME[:METHOD], or cmd:COMMAND.", autocompletion=complete_engines
        ),
    ] = "mujoco",
    json: Json = False,
) -> None:
    """Write gates.toml and .github/workflows/bodycheck.yml, which checks each push and pull request.

    Model files in the folder (.urdf, .sdf) are audited by the workflow. Existing files are left as they are
    and reported.
    """
    from bodycheck.reports.document import json_text
    from bodycheck.runs.new_project import new_project

    written, kept, then = new_project(folder, engine)
    if json:
        print(json_text({"written": written, "kept": kept, "then": then}))
        return
    for path in written:
        print(f"{path}: written")
    for path in kept:
        print(f"{path}: exists, left as it is")
    print("then:")
    for command in then:
        print(f"  {command}")


@project_commands.command(
    short_help="Print the JSON Schema of a file or a message.",
    **described(PROJECT, "bodycheck schema scenario > scenario.schema.json"),
)
def schema(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="scenario, gates, thresholds, engines, manifest, results or protocol.",
            autocompletion=_complete_schemas,
            show_default=False,
        ),
    ] = None,
) -> None:
    """Print the JSON Schema of a file or a message.

    An editor completes and checks a TOML file whose first line names a schema: #:schema scenario.schema.json
    """
    from bodycheck.reports.document import json_text
    from bodycheck.runs.schemas import SCHEMAS, schema_of

    if name is None:
        listed = (f"  {one.name:<12}{one.summary}" for one in SCHEMAS.values())
        raise InputError("\n".join(["bodycheck schema NAME: give one of these names", *listed]))
    print(json_text(schema_of(name).document))
