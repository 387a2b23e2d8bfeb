"""The commands `versions`, `environments list` and `environments remove`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.options import AllowCode, Fresh, Jobs, Threshold, TimeoutS, numbers, thresholds_of
from bodycheck.reports.gates.thresholds import THRESHOLD
from bodycheck.runs.run_options import TIMEOUT_S

versioning = typer.Typer()


@versioning.command(short_help="Find the release in which a measure changed.")
def versions(
    engine: Annotated[str, typer.Argument(help="An engine that is installed from a package, like mujoco.")],
    since: Annotated[str, typer.Option(help="The first release to consider, like 3.6.")],
    until: Annotated[
        str | None, typer.Option(help="The last release to consider.", show_default="the newest")
    ] = None,
    scenario: Annotated[str, typer.Option(help="A built-in scenario or a .toml file.")] = "intermediate-axis",
    method: Annotated[
        str | None, typer.Option(help="A method of the engine.", show_default="every method")
    ] = None,
    measure: Annotated[
        str,
        typer.Option(help="A measure, named as in a gate: energy_drift, order.energy_drift, verdict, ..."),
    ] = "order.orientation_error_rad",
    dt: Annotated[
        str | None, typer.Option(help="Step sizes in s, like 1e-2,1e-3.", show_default="the scenario's")
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
) -> None:
    """Run releases of an engine and print those in which a measure changed.

    Each release runs in its own environment. The exit status is 0 whether or not a measure changed.
    """
    from bodycheck.reports.cache.reuse import reuse_of
    from bodycheck.reports.render.answer_text import print_found
    from bodycheck.runs.run_options import RunOptions
    from bodycheck.runs.version_search import Search, search

    steps = numbers(dt, "--dt")
    asked = Search(
        *(engine, since, until, scenario, method, measure, steps),
        allow_code=allow_code,
        every=every,
        thresholds=thresholds_of(threshold, None),
    )
    options = RunOptions(speed=False, jobs=jobs, timeout_s=timeout_s, reuse=reuse_of(fresh, "installed"))
    print_found(search(asked, options, lambda name: print(name, file=sys.stderr)))


environment_commands = typer.Typer(
    help="List and remove the environments of pinned engine versions.", no_args_is_help=True
)


@environment_commands.command(name="list", short_help="Print one line per environment.")
def list_() -> None:
    """Print one line per environment: engine and version, size, folder; then the sources of its packages."""
    from bodycheck.adapters.versions.environments import environments

    for found in environments():
        print(f"{found.name}  {found.size / 1e6:.0f} MB  {found.folder}")
        for setting in found.packages_from:
            print(f"    {setting}")


@environment_commands.command(short_help="Remove environments.")
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
