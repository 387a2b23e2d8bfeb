"""The command `audit`, and how shards of audits are merged and releases compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.options import (
    MEASURE,
    OUTPUT,
    HtmlFile,
    Json,
    PartFolder,
    Quiet,
    SarifFile,
    TimeoutS,
    check_files,
    described,
    refuse_others,
    write_files,
)
from bodycheck.cli.rooms import Room

if TYPE_CHECKING:
    from bodycheck.reports.comparison.release_results import Found
    from bodycheck.reports.document import Document

audit_commands = typer.Typer()

_TIMEOUT_S = 60.0
_OF_SPELLINGS = ("spellings", "engine", "timeout_s", "json", "quiet")
_OF_LINT = ("model", "lint", "fail_on", "fix", "html", "sarif", "json", "quiet")
_OF_AGAINST = ("model", "against", "fail_on", "html", "sarif", "json", "quiet")
_FAIL_ON = ("error", "warning", "note", "difference", "never")


@audit_commands.command(
    short_help="Compare a model file with what engines import from it.",
    **described(
        MEASURE,
        "bodycheck audit robot.urdf",
        "bodycheck audit robot.urdf --engine mujoco,pybullet==3.2.7 --html audit.html",
        "bodycheck audit --spellings --engine mujoco,mujoco==3.12.0",
        "bodycheck audit robot.xml --lint --fail-on warning --sarif audit.sarif",
        "bodycheck audit robot.urdf --lint --fix corrected.urdf",
        "bodycheck audit robot.usda --against robot.urdf",
    ),
)
def audit(
    context: typer.Context,
    model: Annotated[
        Path | None,
        typer.Argument(help="A URDF, MJCF, SDFormat or USD file; not with --spellings.", show_default=False),
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option(help="Engines, like mujoco,pybullet==3.2.7.", show_default="all with an importer"),
    ] = None,
    lint: Annotated[
        bool, typer.Option("--lint", help="Check only the file itself, without engines.")
    ] = False,
    against: Annotated[
        Path | None,
        typer.Option(
            help="Compare with the bodies that this file states, in place of importers: with the URDF that a "
            "USD stage was made of, for example.",
            show_default=False,
        ),
    ] = None,
    no_spins: Annotated[
        bool, typer.Option("--no-spins", help="Compare only the numbers; do not spin the links.")
    ] = False,
    spellings: Annotated[
        bool,
        typer.Option(
            "--spellings",
            help="Spin a built-in body that is written in many ways, and compare the motions; exit with "
            "status 1 if two differ by more than round-off.",
        ),
    ] = False,
    fail_on: Annotated[
        str,
        typer.Option(
            help="Exit with status 1 on errors of the file (error), also on findings of a lower severity "
            "(warning, note), on any difference or failed import (difference), or on both, like "
            "warning,difference; or in no case (never)."
        ),
    ] = "error",
    fix: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a copy of a URDF to this file, with the corrected numbers of findings that are "
            "certain and have them; all else stays as it is.",
            show_default=False,
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    html: HtmlFile = None,
    sarif: SarifFile = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="K/N",
            help="Import all links, but spin only part K of N of them, chosen by a hash; requires --out. "
            "`bodycheck merge` puts the parts together.",
            show_default="all links",
        ),
    ] = None,
    out: PartFolder = None,
    timeout_s: TimeoutS = _TIMEOUT_S,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare each link and each joint in a file with those that engines import, and the mass matrix.

    bodycheck reads the file in 40-digit arithmetic; each engine imports it in a separate process. Each link
    is then spun freely, and its motion compared with the exact motion of the body in the file.
    """
    from bodycheck._util.shard import Shard
    from bodycheck.audit.audit_against import audit_against
    from bodycheck.audit.audit_document import alerts_of, audit_data, audit_document, failures
    from bodycheck.audit.audit_fix import with_fix
    from bodycheck.audit.audit_merge import write_shard
    from bodycheck.audit.audit_page import audit_page
    from bodycheck.audit.audit_run import AuditOptions
    from bodycheck.audit.audit_run import audit as audited
    from bodycheck.reports.alerts import sarif as as_sarif
    from bodycheck.reports.document import answer
    from bodycheck.reports.render.progress import status_line
    from bodycheck.reports.run_files.writer import check_output

    if spellings == (model is not None):
        raise InputError("audit: give either a model file or --spellings")
    if model is None:
        refuse_others(context, "--spellings: spins a built-in body", _OF_SPELLINGS)
        _spellings(engine, timeout_s, as_json=json, quiet=quiet)
        return
    levels = fail_on.split(",")
    if unknown := [word for word in levels if word not in _FAIL_ON]:
        raise InputError(f"--fail-on {unknown[0]!r}: unknown (available: {', '.join(_FAIL_ON)})")
    if lint:
        refuse_others(context, "--lint: uses no engines", _OF_LINT)
    if against is not None:
        refuse_others(context, "--against: uses no engines", _OF_AGAINST)
    if no_spins and shard is not None:
        raise InputError("--no-spins: leaves nothing to divide; --shard does not apply")
    if (shard is None) != (out is None):
        raise InputError("--shard and --out: give both, to audit a shard")
    if out is not None:
        check_output(out)
    files = {"html": html, "sarif": sarif}
    check_files({**files, "fix": fix})
    engines = [] if lint else None if engine is None else engine.split(",")
    part = None if shard is None else Shard.parse(shard)
    with status_line(f"auditing {model}", quiet=quiet):
        if against is not None:
            found = audit_against(model, against)
        else:
            found = audited(model, AuditOptions(engines, not no_spins, timeout_s=timeout_s, shard=part))
    if part is not None and out is not None:
        write_shard(found, part, out)
    if fix is not None and model is not None:
        found = with_fix(found, model, fix)
    answer(audit_document(found), audit_data(found), as_json=json)
    write_files(
        files,
        {
            "html": lambda: audit_page(found),
            "sarif": lambda: as_sarif(alerts_of(found, differences="difference" in levels)),
        },
        as_json=json,
    )
    if failures(found, levels):
        raise typer.Exit(1)


def _spellings(engine: str | None, timeout_s: float, *, as_json: bool, quiet: bool) -> None:
    from bodycheck.audit.spelling_run import run_spellings, spelling_document
    from bodycheck.reports.document import answer
    from bodycheck.reports.render.progress import status_line

    with status_line("spinning the spellings of one body", quiet=quiet):
        results = run_spellings(None if engine is None else engine.split(","), timeout_s)
    answer(spelling_document(results), results, as_json=as_json)
    if any(one.broken for one in results):
        raise typer.Exit(1)


def _merge(folders: Sequence[Path], out: Path, allow_code: bool) -> tuple[Document, dict[str, Any]]:  # noqa: ARG001 - as Room has it
    from bodycheck.audit.audit_document import audit_data, audit_document
    from bodycheck.audit.audit_merge import merge_audits

    audit, findings = merge_audits(folders, out)
    return audit_document(audit, findings), {**audit_data(audit), "machines": findings}


def _releases(*words: Any, **options: Any) -> Found:
    from bodycheck.audit.audit_versions import audit_versions

    return audit_versions(*words, **options)


ROOM = Room(audit_commands, "audits", "audit.json", _merge, releases=_releases)
