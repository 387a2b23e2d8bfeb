"""The command `merge`: combine shards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.nightly import print_judgement
from bodycheck.cli.options import (
    MEASURE,
    OUTPUT,
    AllowCode,
    Json,
    Threshold,
    ThresholdsFile,
    described,
    folder_option,
    refuse_others,
    thresholds_of,
)
from bodycheck.cli.rooms import rooms
from bodycheck.reports.gates.thresholds import THRESHOLD

merge_commands = typer.Typer()

_OF_A_WHOLE = ("parts", "out", "json")


@merge_commands.command(
    short_help="Combine the shards of a run, an ensemble or an audit.",
    **described(
        MEASURE,
        "bodycheck merge part-* --out whole",
        "bodycheck merge part-* --history nights",
    ),
)
def merge(
    context: typer.Context,
    parts: Annotated[
        list[Path],
        typer.Argument(metavar="PART...", help="Folders of all shards of one run, ensemble or audit."),
    ],
    out: Annotated[Path | None, folder_option("for the whole run, without --history", False)] = None,
    history: Annotated[
        Path | None,
        typer.Option(
            help="Store the whole as a nightly run in this history and compare it, as `nightly` does.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    threshold: Threshold = THRESHOLD,
    thresholds: ThresholdsFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
) -> None:
    """Combine the shards of a run, an ensemble or an audit, and write the files of an undivided run.

    Except for speeds, the tables are those of an undivided run. Differences between the machines are
    reported: versions, and different results of the sentinel cases, which every shard runs.
    """
    from bodycheck.reports.document import answer
    from bodycheck.reports.history.archive import History
    from bodycheck.reports.run_files.writer import check_output
    from bodycheck.reports.summary.sentences import run_data, run_document
    from bodycheck.runs.directory import write_run
    from bodycheck.runs.merge import merge as merged
    from bodycheck.runs.nightly_run import store_nightly

    if (out is None) == (history is None):
        raise InputError("--out or --history: give one of them")
    levels = thresholds_of(threshold, thresholds)
    if out is not None:
        refuse_others(
            context, f"--out {out}: compares the whole with no other run", (*_OF_A_WHOLE, "allow_code")
        )
        check_output(out)
    for room in rooms():
        if any(map(room.has_stored, parts)):
            if out is None:
                raise InputError(f"--history: stores runs, not {room.stores}; give --out")
            if not room.takes_code:
                refuse_others(context, f"{room.stores} run no scenario", _OF_A_WHOLE)
            answer(*room.merge(parts, out, allow_code), as_json=json)
            return
    run = merged(parts, allow_code=allow_code)
    if history is not None:
        judged, run_folder = store_nightly(run, History.at(history), levels)
        print_judgement(judged, run_folder, {}, json=json)
        return
    assert out is not None
    report = write_run(run, out)
    answer(run_document(run), {**run_data(run), **run.manifest["merged"], "report": report}, as_json=json)
    if not json:
        print(report)
