"""The commands `versions`, `environments list` and `environments remove`."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.options import (
    WATCH,
    AllowCode,
    CommandGroup,
    Fresh,
    Jobs,
    Json,
    Quiet,
    ScenarioOption,
    Threshold,
    TimeoutS,
    described,
    numbers,
    progress_of,
    refuse_others,
    steps_option,
    thresholds_of,
)
from bodycheck.cli.rooms import rooms
from bodycheck.reports.gates.thresholds import THRESHOLD
from bodycheck.runs.request import TIMEOUT_S

version_commands = typer.Typer()

_OF_AN_AUDIT = ("engine", "since", "until", "audit", "every", "timeout_s", "json", "quiet")


@version_commands.command(
    short_help="Find the release in which a measure changed.",
    **described(
        WATCH,
        "bodycheck versions mujoco --since 3.6 --method rk4",
        "bodycheck versions mujoco --since 3.6 --measure energy_drift --every --json",
        "bodycheck versions mujoco --since 3.6 --audit robot.urdf",
    ),
)
def versions(
    context: typer.Context,
    engine: Annotated[str, typer.Argument(help="An engine that is installed from a package, like mujoco.")],
    since: Annotated[str, typer.Option(help="The first release to consider, like 3.6.")],
    until: Annotated[
        str | None, typer.Option(help="The last release to consider.", show_default="the newest")
    ] = None,
    scenario: ScenarioOption = "intermediate-axis",
    method: Annotated[
        str | None, typer.Option(help="A method of the engine.", show_default="every method")
    ] = None,
    measure: Annotated[
        str,
        typer.Option(help="A measure, named as in a gate: energy_drift, order.energy_drift, verdict, ..."),
    ] = "order.orientation_error_rad",
    dt: Annotated[str | None, steps_option("the scenario's")] = None,
    audit: Annotated[
        Path | None,
        typer.Option(
            help="Audit this URDF, MJCF or SDFormat file with each release instead of running a scenario."
        ),
    ] = None,
    every: Annotated[
        bool,
        typer.Option(
            "--every",
            help="Run every release instead of bisecting, which also finds changes that were later reverted.",
        ),
    ] = False,
    threshold: Threshold = THRESHOLD,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    fresh: Fresh = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run releases of an engine and print those in which a measure changed.

    Each release runs in its own environment. The exit status is 0 even if a measure changed.
    """
    from bodycheck.reports.comparison.release_results import found_data, found_document
    from bodycheck.reports.document import answer
    from bodycheck.runs.request import Request
    from bodycheck.runs.version_search import ReleaseSearch, search

    announce = partial(_announce, quiet=quiet)
    if audit is not None:
        refuse_others(context, "--audit: runs no scenario", _OF_AN_AUDIT)
        search_releases = next((room.releases for room in rooms() if room.releases is not None), None)
        if search_releases is None:
            raise InputError("--audit: this installation has no audits")
        found = search_releases(
            *(engine, since, until, audit), every=every, timeout_s=timeout_s, announce=announce
        )
        answer(found_document(found), found_data(found), as_json=json)
        return
    steps = numbers(dt, "--dt")
    request = ReleaseSearch(
        *(engine, since, until, scenario, method, measure, steps),
        allow_code=allow_code,
        every=every,
        thresholds=thresholds_of(threshold, None),
    )
    options = Request(speed=False, jobs=jobs, timeout_s=timeout_s, fresh=fresh, laws=False)
    found = search(
        request,
        options,
        announce=announce,
        progress_for=lambda name: progress_of(quiet=quiet, label=name),
    )
    answer(found_document(found), found_data(found), as_json=json)


def _announce(name: str, *, quiet: bool) -> None:
    if not quiet:
        print(name, file=sys.stderr)


environment_commands = typer.Typer(
    cls=CommandGroup, help="Create, list and remove the environments of engines.", no_args_is_help=True
)


@environment_commands.command(
    short_help="Create environments.",
    **described("Commands", "bodycheck environments make drake mujoco==3.17.0"),
)
def make(
    names: Annotated[
        list[str] | None, typer.Argument(help="Engines, NAME or NAME==VERSION, like drake.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Create those of all engines that run only on request.")
    ] = False,
) -> None:
    """Create the environments of engines ahead of a run, and print one line per engine.

    The exit status is 1 if an environment cannot be created.
    """
    from bodycheck.adapters.engine_names import engine_fault
    from bodycheck.adapters.registry import optional_engines
    from bodycheck.adapters.workers.engine_pool import announced

    if every == bool(names):
        raise InputError("environments make: give either names like drake or --all")
    if faults := [fault for name in names or () if (fault := engine_fault(name))]:
        raise InputError("\n".join(faults))
    missing = False
    for name in names or optional_engines():
        engine = announced([name])[name]
        missing |= isinstance(engine, str)
        print(engine if isinstance(engine, str) else f"{name}  {engine.version}")
    if missing:
        raise typer.Exit(1)


@environment_commands.command(
    name="list",
    short_help="Print one line per environment.",
    **described("Commands", "bodycheck environments list"),
)
def list_(json: Json = False) -> None:
    """Print one line per environment: engine and version, size, folder; then the sources of packages."""
    from bodycheck._util.file_digests import disk_bytes
    from bodycheck._util.formatting import count
    from bodycheck.adapters.versions.environments import environments
    from bodycheck.reports.document import Document, Sentence, Table, answer
    from bodycheck.reports.table_layout import Column

    every = environments()
    lead = "no environments: `bodycheck environments make` or the first run of an engine creates them"
    if every:
        total = disk_bytes(found.folder for found in every) / 1e6
        lead = (
            f"{count(len(every), 'environment')}, together {total:.0f} MB, where shared files count once, "
            f"in {every[0].folder.parent}"
        )
    columns = (Column("engine", "fixed"), Column("size", "number"), Column("folder", "fixed"))
    rows = tuple((found.name, f"{found.size / 1e6:.0f} MB", found.folder.name) for found in every)
    users: dict[tuple[str, ...], list[str]] = {}
    for found in every:
        users.setdefault(found.packages_from, []).append(found.name)
    sources = [
        Sentence(f"packages of {', '.join(names)}: {'; '.join(settings)}")
        for settings, names in users.items()
        if settings
    ]
    document = Document(
        "bodycheck environments list", (Sentence(lead, strong=True), Table(columns, rows), *sources)
    )
    answer(document, every, as_json=json)


@environment_commands.command(
    short_help="Remove environments.",
    **described("Commands", "bodycheck environments remove mujoco==3.17.0"),
)
def remove(
    names: Annotated[
        list[str] | None, typer.Argument(help="Names as printed by `list`, like mujoco==3.17.0.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Remove every environment.")] = False,
) -> None:
    """Remove environments by name and print their folders; they are created again when needed."""
    from bodycheck.adapters.versions import environments

    if every == bool(names):
        raise InputError("environments remove: give either names like mujoco==3.17.0 or --all")
    found = environments.environments()
    unknown = set(names or ()) - {one.name for one in found}
    if unknown:
        known = ", ".join(dict.fromkeys(one.name for one in found)) or "none"
        raise InputError(f"no environment for {', '.join(sorted(unknown))} (available: {known})")
    for one in found:
        if every or one.name in (names or ()):
            try:
                environments.remove(one)
            except OSError as error:
                raise InputError(f"{one.folder}: cannot be removed: {error.strerror or error}") from None
            print(one.folder)
