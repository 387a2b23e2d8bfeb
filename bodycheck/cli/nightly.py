"""The commands `nightly` and `history`: store nightly runs and compare each with the earlier ones."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from os.path import relpath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.options import (
    HOW,
    WATCH,
    Files,
    Github,
    HtmlFile,
    Json,
    JunitFile,
    MarkdownFile,
    PartFolder,
    Quiet,
    Threshold,
    ThresholdsFile,
    check_files,
    described,
    progress_of,
    refuse_others,
    request_words,
    takes_request,
    tell_github,
    thresholds_of,
    write_files,
)
from bodycheck.reports.gates.thresholds import THRESHOLD
from bodycheck.runs.request import Request

if TYPE_CHECKING:
    from bodycheck.reports.history.acceptances import Acceptance
    from bodycheck.reports.history.regression import Judgement

nightly = typer.Typer()
history = typer.Typer(
    help="List, query and prune a history of nightly runs, and accept changes.", no_args_is_help=True
)
nightly.add_typer(history, name="history", rich_help_panel=WATCH)

_EXITS = {"no regression": 0, "regression": 1, "nothing measured": 1, "insufficient history": 3}

_LEFT_OUT = 1

_RESUMED = (
    *("history", "threshold", "thresholds", "fail_on", "resume", "html", "markdown", "junit", "github"),
    *("engines", "allow_code", "json", "quiet"),
)

_Folder = Annotated[Path, typer.Argument(metavar="HISTORY", help="Folder of a history.")]


@nightly.command(
    name="nightly",
    short_help="Run, store, and compare with earlier runs.",
    **described(WATCH, "bodycheck nightly --history nights --engine mujoco,reference:rk4"),
)
@takes_request("dt_s", "tolerances", "fresh", "cluster", "tls_ca_file", "tls_cert", "tls_key", "insecure")
def nightly_(
    context: typer.Context,
    request: Callable[..., Request],
    history: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the history; created if it does not exist.",
            show_default="required without --shard",
        ),
    ] = None,
    threshold: Threshold = THRESHOLD,
    thresholds: ThresholdsFile = None,
    fail_on: Annotated[
        Literal["open", "newly-worse"],
        typer.Option(
            help="Exit with status 1 while a regression is open, or only if this run is worse than the one "
            "before."
        ),
    ] = "open",
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Continue the newest interrupted run of the history, with its settings.",
            rich_help_panel=HOW,
        ),
    ] = False,
    out: PartFolder = None,
    github: Github = False,
    html: HtmlFile = None,
    markdown: MarkdownFile = None,
    junit: JunitFile = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run scenarios, append the run to a history, and compare it with the earlier nightly runs.

    A regression stays open until it is gone or accepted with `bodycheck history accept`. The exit status is 1
    while one is open or if nothing was measured, and 3 if the history is insufficient to compare with.
    """
    from bodycheck.runs.directory import run_to_folder
    from bodycheck.runs.nightly_run import SPEED_PASSES, resume_nightly, run_nightly

    levels = thresholds_of(threshold, thresholds)
    files = {"html": html, "markdown": markdown, "junit": junit}
    check_files(files)
    # a stored result would hide a change of the engine
    requested = request(fresh=True, speed_passes=SPEED_PASSES)
    if (shard := requested.shard) is not None:
        reason = f"--shard {shard}: `bodycheck merge --history` stores and compares the whole run"
        refuse_others(context, reason, (*request_words(), "out", "quiet"))
        if out is None:
            raise InputError(f"--shard {shard}: requires --out, the folder of this shard")
        _, report = run_to_folder(requested, out, progress_of(quiet=quiet))
        print(report)
        return
    if history is None or out is not None:
        raise InputError("--out: requires --shard" if out else "--history: required, the folder of a history")
    if resume:
        refuse_others(context, "--resume: continues with the settings of the interrupted run", _RESUMED)
        allow_code = requested.allow_code
        judged, run_folder = resume_nightly(history, progress_of(quiet=quiet), levels, allow_code=allow_code)
    else:
        judged, run_folder = run_nightly(requested, history, progress_of(quiet=quiet), levels)
    print_judgement(judged, run_folder, files, json=json, github=github, fail_on=fail_on)


def print_judgement(
    judged: Judgement,
    run_folder: Path,
    files: Files,
    *,
    json: bool,
    github: bool = False,
    fail_on: Literal["open", "newly-worse"] = "open",
) -> None:
    """Print the judgement of a stored nightly run, write the files, and exit with its status."""
    from bodycheck.reports.alerts import junit as as_junit
    from bodycheck.reports.document import answer, markdown
    from bodycheck.reports.history.history_output import (
        alerts_of,
        nightly_data,
        nightly_document,
        nightly_page,
    )

    document, data = nightly_document(judged), {**nightly_data(judged), "folder": run_folder}
    answer(document, data, as_json=json)
    if github:
        tell_github(alerts_of(judged), "bodycheck nightly", document, as_json=json)
    html = files.get("html") or Path()
    write_files(
        files,
        {
            "html": lambda: nightly_page(judged, relpath(run_folder, html.parent) + "/"),
            "markdown": lambda: markdown(document),
            "junit": lambda: as_junit(alerts_of(judged), "bodycheck nightly"),
        },
        as_json=json,
    )
    if not json:
        print(run_folder / "night.html")
    only_open = judged.status == "regression" and not any(one.newly for one in judged.open)
    raise typer.Exit(0 if only_open and fail_on == "newly-worse" else _EXITS[judged.status])


@history.command(
    name="list",
    short_help="Print one line per nightly run.",
    **described("Commands", "bodycheck history list nights"),
)
def list_(folder: _Folder, json: Json = False) -> None:
    """Print one line per nightly run, oldest first: status, number of changes, cases and engines.

    Damaged runs are reported on standard error and excluded; the exit status is then 1.
    """
    from bodycheck.reports.document import answer
    from bodycheck.reports.history.archive import History
    from bodycheck.reports.history.baseline import readable_runs
    from bodycheck.reports.history.history_output import history_data, history_document
    from bodycheck.reports.history.queries import history_table

    runs, left_out = readable_runs(History.existing(folder).runs())
    table = history_table(runs)
    answer(history_document(table), history_data(table), as_json=json)
    _report_left_out(left_out)


@history.command(
    short_help="Query nightly runs in SQL.",
    **described("Commands", "bodycheck history query nights 'SELECT run_id, status FROM nights'"),
)
def query(
    folder: _Folder,
    sql: Annotated[
        str,
        typer.Argument(
            help="A SELECT from nights, changes and the tables of a run, such as results or laws."
        ),
    ],
    as_: Annotated[Literal["csv", "json", "md"], typer.Option("--format", help="Output format.")] = "csv",
) -> None:
    """Print the result of a SELECT on the tables of all nightly runs; nights has one row per nightly run.

    Damaged runs are reported on standard error and excluded; the exit status is then 1.
    """
    from bodycheck.reports.history.archive import History
    from bodycheck.reports.history.baseline import readable_runs
    from bodycheck.reports.history.queries import query as run_query
    from bodycheck.reports.history.queries import tables_in
    from bodycheck.reports.run_files.tables import FORMATS

    runs, left_out = readable_runs(History.existing(folder).runs(), tables_in(sql))
    sys.stdout.write(FORMATS[as_](run_query(runs, sql)).decode())
    _report_left_out(left_out)


@history.command(
    short_help="Accept open regressions, with a reason.",
    **described(
        "Commands",
        "bodycheck history accept nights --change 1f0c9a4e --reason 'the new integrator is meant'",
        "bodycheck history accept nights --run 20261125T033000Z --reason 'release 4.0.0'",
    ),
)
def accept(
    folder: _Folder,
    reason: Annotated[str, typer.Option(help="Why the change is accepted; shown on later pages.")],
    run: Annotated[
        str | None,
        typer.Option(
            help="Accept what is open after this nightly run: its run id, or the beginning of it.",
            show_default="the newest run",
        ),
    ] = None,
    change: Annotated[
        str | None,
        typer.Option(
            help="Ids of the changes to accept, separated by commas; the page of a run has them.",
            show_default="all that are open, which requires --run",
        ),
    ] = None,
    author: Annotated[
        str | None, typer.Option(help="Who accepts it.", show_default="the name of the user")
    ] = None,
    json: Json = False,
) -> None:
    """Accept open regressions: the next nightly run compares with the accepted values.

    Prints the id of the acceptance; `bodycheck history withdraw` withdraws it.
    """
    from bodycheck.reports.history.acceptances import accept as accept_changes
    from bodycheck.reports.history.archive import History

    if run is None and change is None:
        raise InputError("--run or --change: required, what to accept")
    ids = [] if change is None else [one.strip() for one in change.split(",")]
    history = History.existing(folder)
    _print_acceptances(accept_changes(history, run_id=run, ids=ids, reason=reason, author=author), json=json)


@history.command(
    short_help="Withdraw an acceptance.",
    **described("Commands", "bodycheck history withdraw nights 5d21f3aa"),
)
def withdraw(
    folder: _Folder,
    acceptance: Annotated[str, typer.Argument(help="Id of the acceptance.")],
    json: Json = False,
) -> None:
    """Withdraw an acceptance: the next nightly run compares with the levels before it."""
    from bodycheck.reports.history.acceptances import withdraw as withdraw_acceptance
    from bodycheck.reports.history.archive import History

    _print_acceptances([withdraw_acceptance(History.existing(folder), acceptance)], json=json)


def _print_acceptances(acceptances: Sequence[Acceptance], *, json: bool) -> None:
    from bodycheck.reports.document import Document, Sentence, answer
    from bodycheck.reports.history.acceptances import acceptance_text

    lines = tuple(Sentence(acceptance_text(one)) for one in acceptances)
    answer(Document("bodycheck: acceptances", lines), acceptances, as_json=json)


@history.command(
    short_help="Remove old nightly runs.",
    **described("Commands", "bodycheck history prune nights --keep 60"),
)
def prune(
    folder: _Folder, keep: Annotated[int, typer.Option(help="Number of newest nightly runs to keep.")]
) -> None:
    """Remove all but the newest nightly runs, and print the names of the removed ones."""
    from bodycheck.reports.history.archive import History

    history = History.existing(folder)
    for run in history.dated_in_future():
        print(f"{run}: is dated in the future; neither counted nor removed", file=sys.stderr)
    for name in history.prune(keep):
        print(name)


def _report_left_out(left_out: Sequence[str]) -> None:
    """Report nightly runs that were left out on standard error, and exit with status 1 if there are any."""
    for fault in left_out:
        print(f"{fault}; this nightly run is excluded", file=sys.stderr)
    if left_out:
        raise typer.Exit(_LEFT_OUT)
