"""The commands on engines: check an adapter or create one, identify methods and check their laws."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from bodycheck.cli.options import (
    ADAPTERS,
    MEASURE,
    AllowCode,
    EnginesFile,
    HtmlFile,
    Json,
    MarkdownFile,
    Quiet,
    TimeoutS,
    admit_engines,
    check_files,
    complete_engines,
    described,
    write_files,
)
from bodycheck.runs.request import TIMEOUT_S

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
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check frames, units, loads, stages, read-back, reset, steps and refusals of an engine's adapter.

    Each failure is described. The exit status is 1 if a check fails.
    """
    from bodycheck.reports.document import answer
    from bodycheck.reports.render.progress import status_line
    from bodycheck.runs.engine_checks import check_adapter, conformance_document

    admit_engines(engines, allow_code=allow_code)
    with status_line(f"checking {engine}", quiet=quiet):
        found = check_adapter(engine, timeout_s=timeout_s, allow_code=allow_code)
    answer(conformance_document(found), found, as_json=json)
    if found.failures:
        raise typer.Exit(1)


@adapter_commands.command(
    name="new-adapter",
    short_help="Write a new adapter in Python, C or Rust.",
    **described(
        ADAPTERS,
        "bodycheck new-adapter my-engine",
        "bodycheck new-adapter my-engine --language rust",
        "bodycheck new-adapter my-engine --tree",
    ),
)
def new(
    name: Annotated[str, typer.Argument(help="The engine's name, lower case, like my-engine.")],
    language: Annotated[
        Literal["python", "c", "rust"],
        typer.Option(
            help="python: a package with its tests, for an engine with Python bindings. c (also for C++), "
            "rust: a program that speaks the worker protocol; docs/workers.md has one in JavaScript, and "
            "what any other language needs."
        ),
    ] = "python",
    tree: Annotated[
        bool, typer.Option("--tree", help="Also write what the engine reports of trees, in Python.")
    ] = False,
    json: Json = False,
) -> None:
    """Write a working example of an adapter into ./bodycheck-NAME, and print how to build and check it."""
    from bodycheck.reports.document import Command, Document, Sentence, answer
    from bodycheck.runs.new_adapter import new_adapter

    folder, commands = new_adapter(name, language, tree=tree)
    sentence = Sentence(f"{folder} is written: replace the example by calls of the engine, then")
    document = Document("bodycheck new-adapter", (sentence, *(Command(command) for command in commands)))
    answer(document, {"folder": folder, "commands": commands}, as_json=json)


identity_commands = typer.Typer()

_Engine = Annotated[
    str,
    typer.Argument(
        metavar="ENGINE",
        help="NAME[==VERSION][:METHOD],..., cmd:COMMAND[::METHOD] or MODULE:FUNCTION.",
        autocompletion=complete_engines,
    ),
]


@identity_commands.command(
    short_help="Identify the one-step map of a method.",
    **described(
        MEASURE,
        "bodycheck fingerprint mujoco",
        "bodycheck fingerprint mujoco==3.7.0:implicitfast --all-loads",
        "bodycheck fingerprint my_module:step --allow-code",
    ),
)
def fingerprint(
    engine: _Engine,
    all_loads: Annotated[
        bool,
        typer.Option(
            "--all-loads", help="Also apply loads that vary with time and motion; may compile kernels."
        ),
    ] = False,
    timeout_s: TimeoutS = TIMEOUT_S,
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare single steps of each method with all known maps, free and under each load.

    Prints the nearest map, the largest distance to it in rad and relative to omega, and the runner-up with
    its distance. If no known map matches, prints the local order and the leading error term.
    """
    from bodycheck.reports.document import answer
    from bodycheck.reports.render.progress import status_line
    from bodycheck.reports.summary.method_identity import fingerprint_document
    from bodycheck.runs.engine_checks import fingerprints

    admit_engines(engines, allow_code=allow_code)
    with status_line(f"comparing {engine} with known maps", quiet=quiet):
        rows = fingerprints(engine, timeout_s=timeout_s, all_loads=all_loads, allow_code=allow_code)
    answer(fingerprint_document(rows), rows, as_json=json)


@identity_commands.command(
    short_help="Compare the derivatives of a differentiable engine with exact ones.",
    **described(MEASURE, "bodycheck gradients mjx:euler@float64", "bodycheck gradients newton,mjx"),
)
def gradients(
    engine: _Engine,
    html: HtmlFile = None,
    markdown: MarkdownFile = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare derivatives of a motion's end by moments of inertia and first omega with exact ones.

    Three motions are differentiated by the engine itself, such as by jax.jacfwd or wp.Tape. A derivative is
    right if differences of the engine's own motions agree with it; the distance to the exact derivative falls
    with the step. A missing term or a wrong factor is named. The exit status is 1 if a derivative is wrong.
    """
    from bodycheck.reports import document
    from bodycheck.reports.render.progress import status_line
    from bodycheck.runs.gradients_run import gradients as computed
    from bodycheck.runs.gradients_run import gradients_document

    files = {"html": html, "markdown": markdown}
    check_files(files)
    admit_engines(engines, allow_code=allow_code)
    with status_line(f"differentiating motions by {engine}", quiet=quiet):
        found = computed(engine.split(","), timeout_s, allow_code=allow_code)
    shown = gradients_document(found)
    document.answer(shown, found, as_json=json)
    write_files(
        files,
        {
            "html": lambda: document.page(shown),
            "markdown": lambda: document.markdown(shown),
        },
        as_json=json,
    )
    if any(one.wrong for one in found):
        raise typer.Exit(1)


@identity_commands.command(
    short_help="Check the laws that every method must obey.",
    **described(MEASURE, "bodycheck laws pybullet", "bodycheck laws pybullet:multibody@defaults"),
)
def laws(
    engine: _Engine,
    timeout_s: TimeoutS = TIMEOUT_S,
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check that other descriptions of a scene, such as rotated axes, give the same motion.

    Prints the largest violation of each law, its tolerance, and the state that shows it most. The exit status
    is 1 if a law is broken; a property, such as a step that is not reversible, does not count.
    """
    from bodycheck.reports.document import answer
    from bodycheck.reports.render.progress import status_line
    from bodycheck.reports.summary.method_identity import laws_document
    from bodycheck.runs.engine_checks import laws as checked

    admit_engines(engines, allow_code=allow_code)
    with status_line(f"checking the laws on {engine}", quiet=quiet):
        rows = checked(engine, timeout_s=timeout_s, allow_code=allow_code)
    answer(laws_document(rows), rows, as_json=json)
    if any(row["verdict"] == "broken" for row in rows):
        raise typer.Exit(1)
