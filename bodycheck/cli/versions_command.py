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
    engine: Annotated[str, typer.Argument(help="The name of an engine that a package brings, like mujoco.")],
    since: Annotated[str, typer.Option(help="The first release that counts, like 3.6.")],
    until: Annotated[
        str | None, typer.Option(help="The last release that counts.", show_default="the newest")
    ] = None,
    scenario: Annotated[str, typer.Option(help="A built-in name or a .toml file.")] = "intermediate-axis",
    method: Annotated[
        str | None, typer.Option(help="One method of the engine.", show_default="each of them")
    ] = None,
    measure: Annotated[
        str, typer.Option(help="As of a gate: energy_drift, order.energy_drift, verdict, ...")
    ] = "order.orientation_error_rad",
    dt: Annotated[
        str | None, typer.Option(help="Steps in s, like 1e-2,1e-3; the scenario's own, unless told.")
    ] = None,
    every: Annotated[
        bool,
        typer.Option("--every", help="Run every release, so that a change that was undone is found too."),
    ] = False,
    threshold: Threshold = THRESHOLD,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    fresh: Fresh = None,
    allow_code: AllowCode = False,
) -> None:
    """Run releases of an engine, each in an environment of its own; name those in which a measure changed.

    The status is 0 whatever changed: this informs, it does not judge.
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
    help="List and remove the environments of engines in versions of their own.", no_args_is_help=True
)


@environment_commands.command(name="list", short_help="Print one line per environment.")
def list_() -> None:
    """Print one line per environment: what it is for, its size, from where its packages came, its folder."""
    from bodycheck.adapters.versions.environments import environments

    for found in environments():
        print(f"{found.name}  {found.size / 1e6:.0f} MB  {found.folder}")
        for setting in found.packages_from:
            print(f"    {setting}")


@environment_commands.command(short_help="Remove environments.")
def remove(
    names: Annotated[
        list[str] | None, typer.Argument(help="Like mujoco==3.17.0, as `list` has them.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Remove all of them.")] = False,
) -> None:
    """Remove environments by name, and print their folders; they are made again when they are needed."""
    from bodycheck.adapters.versions import environments

    if every == bool(names):
        raise InputError("environments remove: give names like mujoco==3.17.0, or --all")
    found = environments.environments()
    unknown = set(names or ()) - {one.name for one in found}
    if unknown:
        known = ", ".join(dict.fromkeys(one.name for one in found)) or "none"
        raise InputError(f"no environment of {', '.join(sorted(unknown))} (available: {known})")
    for one in found:
        if every or one.name in (names or ()):
            try:
                environments.remove(one)
            except OSError as error:
                raise InputError(f"{one.folder}: cannot be removed: {error.strerror or error}") from None
            print(one.folder)
