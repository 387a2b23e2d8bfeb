"""The commands for authors of adapters: check one, and make the package of a new one."""

from __future__ import annotations

from typing import Annotated

import typer

from bodycheck.cli.help_text import ADAPTERS, described
from bodycheck.cli.options import AllowCode, Json, Quiet, TimeoutS, complete_engines
from bodycheck.runs.run_options import TIMEOUT_S

adapter_commands = typer.Typer()


@adapter_commands.command(
    name="check-adapter",
    short_help="Check an engine's adapter against the contract.",
    **described(
        ADAPTERS,
        "bodycheck check-adapter mujoco:rk4",
        'bodycheck check-adapter "cmd:node docs/workers/m1.mjs"',
        "bodycheck check-adapter my_module:step --allow-code",
    ),
)
def check(
    engine: Annotated[
        str,
        typer.Argument(
            help="NAME[==VERSION][:METHOD], cmd:COMMAND[::METHOD] or MODULE:FUNCTION.",
            autocompletion=complete_engines,
        ),
    ],
    timeout_s: TimeoutS = TIMEOUT_S,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check frames, units, loads, stages, read-back, reset, steps and refusals of an engine's adapter.

    Each failure says what is wrong. The exit status is 1 if a check fails.
    """
    from bodycheck.reports.document import answer
    from bodycheck.reports.render.progress import watched
    from bodycheck.runs.check_adapter import check_adapter, conformance_document

    with watched(f"checking {engine}", quiet=quiet):
        found = check_adapter(engine, timeout_s=timeout_s, allow_code=allow_code)
    answer(conformance_document(found), found, as_json=json)
    if found.failures:
        raise typer.Exit(1)


@adapter_commands.command(
    name="new-adapter",
    short_help="Write the package of a new adapter.",
    **described(ADAPTERS, "bodycheck new-adapter my-engine"),
)
def new(
    name: Annotated[str, typer.Argument(help="The engine's name, lower case, like my-engine.")],
    json: Json = False,
) -> None:
    """Write a package into ./bodycheck-NAME: pyproject.toml, a working example adapter, and its tests."""
    from bodycheck.reports.document import Command, Document, Sentence, answer
    from bodycheck.runs.new_adapter import new_adapter

    folder = new_adapter(name)
    parts = (
        Sentence(f"{folder} is written: replace the example by calls of the engine, then"),
        Command(f"pip install -e {folder}"),
        Command(f"bodycheck check-adapter {name}"),
    )
    answer(Document("bodycheck new-adapter", parts), {"folder": folder}, as_json=json)
