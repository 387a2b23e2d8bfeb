"""The commit of a run, and the range of commits of a change."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bodycheck._util.errors import InputError
from bodycheck._util.source_commit import COMMIT_VARIABLES, commit_range, comparison_url, source_commit
from bodycheck.reports.comparison.compare import compare
from bodycheck.reports.comparison.comparison_document import alerts_of, comparison_data, sentences
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.runs.request import Request
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.gate_tables import make_tables
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import SCENARIO

OLD, NEW = "0123456789abcdef" * 2, "fedcba9876543210" * 2
GITHUB = {"GITHUB_SERVER_URL": "https://github.com", "GITHUB_REPOSITORY": "me/engine"}
ERROR = "orientation_error_rad"


@pytest.mark.parametrize("variable", COMMIT_VARIABLES)
def test_commit_of_each_service_is_found(variable: str) -> None:
    """The option has precedence; an empty or unusable variable does not count."""
    assert source_commit(None, {variable: OLD}) == {"id": OLD}
    assert source_commit("v1.2", {variable: OLD}) == {"id": "v1.2"}
    assert source_commit(None, {variable: ""}) is None
    assert source_commit(None, {variable: "a b\n"}) is None


@pytest.mark.parametrize("commit", ["", "-x", "a b", "a\nb", "x" * 101])
def test_what_is_no_commit_is_refused(commit: str, expected_message: ExpectedMessage) -> None:
    """One line names the option."""
    with expected_message.raises(InputError):
        source_commit(commit, {})


@pytest.mark.parametrize(
    ("variables", "page"),
    [
        (GITHUB, f"https://github.com/me/engine/compare/{OLD}...{NEW}"),
        ({"CI_PROJECT_URL": "https://gitlab.com/me/e"}, f"https://gitlab.com/me/e/-/compare/{OLD}...{NEW}"),
        ({"CI_PROJECT_URL": "javascript:alert(1)"}, ""),
        ({}, ""),
    ],
)
def test_page_of_the_range_is_that_of_the_service(variables: dict[str, str], page: str) -> None:
    """Only a web address counts."""
    manifests = [{"source": source_commit(commit, variables)} for commit in (OLD, NEW)]
    assert commit_range(manifests[0], manifests[1]) == "0123456789..fedcba9876"
    assert comparison_url(manifests[0], manifests[1]) == page


@pytest.mark.parametrize("source", [None, 7, {}, {"id": 7}, {"id": OLD}, "absent"])
def test_unknown_or_equal_commits_have_no_range(source: Any) -> None:
    """Manifests of earlier versions have no commit, and damaged ones anything."""
    before = {} if source == "absent" else {"source": source}
    after = {"source": {"id": OLD, "url": "https://github.com/me/engine"}}
    assert (commit_range(before, after), comparison_url(before, after)) == ("", "")


def run(commit: str | None, error: float, version: str = "1.0") -> Tables:
    """Return a run of one engine at a commit."""
    engines = {"mujoco": {"version": version, "methods": {}}}
    named = {"engines": engines, "scenarios": {}, "created": "today", "bodycheck": "1", "run_id": "r"}
    return make_tables([{ERROR: error}], **named, source=source_commit(commit, GITHUB))


def test_a_change_names_its_range_of_commits() -> None:
    """The line of the change has it unless the version changed, and the answer has the page that shows it."""
    comparison = compare(run(OLD, 1e-9), run(NEW, 1e-6))
    (alert,) = alerts_of(comparison, ("worse", "missing"))
    assert (
        alert.message == "mujoco:rk4: error at dt 0.01 s x 1e3 in brick (in commits 0123456789..fedcba9876)"
    )
    page = f"https://github.com/me/engine/compare/{OLD}...{NEW}"
    assert f"Commits 0123456789..fedcba9876: {page}" in sentences(comparison)
    assert comparison_data(comparison)["commits"] == f"0123456789..fedcba9876: {page}"
    (alert,) = alerts_of(compare(run(OLD, 1e-9), run(NEW, 1e-6, "2.0")), ("worse",))
    assert alert.message.endswith("(since version 2.0, 1.0 before)")
    unknown = compare(run(None, 1e-9), run(None, 1e-6))
    assert "ommits" not in " ".join(sentences(unknown))


@pytest.mark.slow
def test_the_commit_is_stored_with_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the option, or by the environment."""
    (tmp_path / "mine.toml").write_text(SCENARIO)
    monkeypatch.delenv("CI_PROJECT_URL", raising=False)
    for name, value in {**GITHUB, "GITHUB_SHA": OLD}.items():
        monkeypatch.setenv(name, value)
    words = ["run", "mine.toml", "--engine", "reference:m1", "--dt", "0.1", "--no-speed", "--quiet"]
    for out, options, commit in (("a", [], OLD), ("b", ["--commit", "v2"], "v2")):
        done = run_bodycheck(tmp_path, *words, "--out", out, *options)
        assert done.returncode == 0, done.stderr
        manifest = json.loads((tmp_path / out / "manifest.json").read_text())
        assert manifest["source"] == {"id": commit, "url": "https://github.com/me/engine"}
    assert run_bodycheck(tmp_path, *words, "--commit", "a b").returncode == 2
    assert Request().commit is None
