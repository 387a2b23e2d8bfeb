"""The commit that a run measures: as the user names it, or as continuous integration does."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any

from bodycheck._util.errors import InputError

COMMIT_VARIABLES = (
    "GITHUB_SHA",
    "CI_COMMIT_SHA",  # GitLab
    "BUILDKITE_COMMIT",
    "CIRCLE_SHA1",
    "TRAVIS_COMMIT",
    "BITBUCKET_COMMIT",
    "BUILD_SOURCEVERSION",  # Azure Pipelines
    "DRONE_COMMIT_SHA",
    "GIT_COMMIT",  # Jenkins
)
"""The environment variables that hold the commit, in the order in which they are tried."""

_NAME = re.compile(r"[0-9A-Za-z][0-9A-Za-z._/-]{0,99}")
_HASH = re.compile(r"[0-9a-f]{12,64}")
_SHORT = 10


def source_commit(
    requested: str | None, environment: Mapping[str, str] = os.environ
) -> dict[str, str] | None:
    """Return the commit and, if known, the address of its repository; None without a commit.

    requested: that of --commit. Raises InputError if it cannot be a commit.
    """
    if requested is not None and not _NAME.fullmatch(requested):
        raise InputError(f"--commit {requested!r}: is not a commit (expected a hash or a tag)")
    found = [requested, *(environment.get(name) for name in COMMIT_VARIABLES)]
    commit = next((one for one in found if one and _NAME.fullmatch(one)), None)
    if commit is None:
        return None
    url = environment.get("CI_PROJECT_URL", "")
    if "GITHUB_REPOSITORY" in environment:
        url = (
            f"{environment.get('GITHUB_SERVER_URL', 'https://github.com')}/{environment['GITHUB_REPOSITORY']}"
        )
    elif url:
        url += "/-"  # GitLab
    return {"id": commit, **({"url": url} if re.fullmatch(r"https://[^\s<>\"']{1,300}", url) else {})}


def commit_range(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Return "abc..def", the commits of two manifests; "" if one is unknown or both are the same."""
    old, new = _source(before), _source(after)
    if not (old.get("id") and new.get("id")) or old["id"] == new["id"]:
        return ""
    return f"{_shortened(old['id'])}..{_shortened(new['id'])}"


def comparison_url(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Return the page of the code hosting service with the changes between two manifests; "" if unknown."""
    old, new = _source(before), _source(after)
    if not commit_range(before, after) or not old.get("url") or old["url"] != new.get("url"):
        return ""
    return f"{old['url']}/compare/{old['id']}...{new['id']}"


def _source(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return the commit of a manifest; manifests of earlier versions, and damaged ones, have none."""
    entry = manifest.get("source")
    found = entry if isinstance(entry, dict) else {}
    return {key: text for key, text in found.items() if isinstance(text, str)}


def _shortened(commit: str) -> str:
    return commit[:_SHORT] if _HASH.fullmatch(commit) else commit
