"""The command `versions`: in which release of an engine a measure changed."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from bodycheck.manner import TIMEOUT_S
from bodycheck.number_list import numbers
from bodycheck.options import AllowCode, Fresh, Jobs, Threshold, TimeoutS
from bodycheck.reports.comparison.thresholds import THRESHOLD
from bodycheck.weighing import thresholds_of

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
    from bodycheck.manner import Manner
    from bodycheck.reports.storage.reuse import reuse_of
    from bodycheck.reports.version_text import print_found
    from bodycheck.version_search import Search, search

    steps = numbers(dt, "--dt")
    asked = Search(
        *(engine, since, until, scenario, method, measure, steps),
        allow_code=allow_code,
        every=every,
        thresholds=thresholds_of(threshold, None),
    )
    manner = Manner(speed=False, jobs=jobs, timeout_s=timeout_s, reuse=reuse_of(fresh, "installed"))
    print_found(search(asked, manner, lambda name: print(name, file=sys.stderr)))
