"""What a release needs is complete and says one thing: versions, addresses, workflows, archives."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.helpers.doc_pages import ROOT, text_of

PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SETTINGS: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
NOTES = [sys.executable, str(ROOT / "scripts/release_notes.py")]
FILES = [
    *ROOT.glob("*.md"),
    *ROOT.glob("*.cff"),
    *ROOT.glob("*.yml"),
    *ROOT.glob("docs/**/*.md"),
    *ROOT.glob(".github/**/*.yml"),
    *ROOT.glob(".github/**/*.md"),
]


def test_addresses_are_those_of_the_project() -> None:
    """Each address of the project's own repository or pages begins with one of pyproject.toml."""
    known = set(PROJECT["urls"].values())
    pattern = r"https://(?:github\.com/[\w.-]+/bodycheck|bodycheck\.[\w.]+)[\w./-]*"
    found = {address for file in FILES for address in re.findall(pattern, file.read_text())}
    assert found
    assert {address for address in found if not address.startswith(tuple(known))} == set()


def test_citation_is_of_this_version() -> None:
    """CITATION.cff has the version, the license and the addresses of pyproject.toml, and BibTeX its data."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == PROJECT["version"]
    assert cited["license"] in PROJECT["license"]
    assert cited["repository-code"] == PROJECT["urls"]["Source"]
    assert cited["url"] == PROJECT["urls"]["Documentation"]
    bibtex = dict(re.findall(r"^  (\w+) += \{+(.+?)\}+,?$", text_of("docs/contributing.md"), re.MULTILINE))
    (author,) = cited["authors"]
    (year,) = re.findall(r'project_copyright = f"(\d{4}),', text_of("docs/conf.py"))
    assert bibtex == {
        "author": author["name"],
        "title": cited["title"],
        "version": cited["version"],
        "year": year,
        "url": cited["repository-code"],
        "license": cited["license"],
    }


def test_supported_pythons_are_the_same_everywhere() -> None:
    """The classifiers, the lowest version and the tests of a push name the same versions of Python."""
    prefix = "Programming Language :: Python :: 3."
    minors = [int(one.removeprefix(prefix)) for one in PROJECT["classifiers"] if one.startswith(prefix)]
    assert minors == [*range(minors[0], minors[-1] + 1)]
    assert PROJECT["requires-python"] == f">=3.{minors[0]}"
    tests = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text())["jobs"]["tests"]
    assert tests["strategy"]["matrix"]["python"] == [f"3.{minor}" for minor in minors]


CHANGES = {
    "the section of the tag": (
        "## 0.2.0 (2026-11-26)\n\n### Added\n\n- A.\n\n## 0.1.0\n\n- B.\n",
        "v0.2.0",
        0,
    ),
    "another tag": ("## 0.2.0\n\n- A.\n", "v0.3.0", 1),
    "no section": ("## Unreleased\n\n- A.\n", "v0.2.0", 1),
    "an empty section": ("## 0.2.0\n\n## 0.1.0\n\n- B.\n", "v0.2.0", 1),
    "a longer version": ("## 0.2.0.1\n\n- A.\n", "v0.2.0", 1),
}


@pytest.mark.parametrize("case", CHANGES)
def test_release_needs_its_version_and_its_notes(case: str, tmp_path: Path) -> None:
    """A tag is released only with its version in pyproject.toml and a section with entries."""
    text, tag, status = CHANGES[case]
    (tmp_path / "scripts").mkdir()
    shutil.copy(NOTES[1], tmp_path / "scripts")
    (tmp_path / "pyproject.toml").write_text('[project]\nversion = "0.2.0"\n')
    (tmp_path / "CHANGELOG.md").write_text(text)
    script = tmp_path / "scripts/release_notes.py"
    done = subprocess.run([sys.executable, script, tag], capture_output=True, text=True, check=False)
    assert done.returncode == status
    assert len(done.stderr.splitlines()) == status
    assert (done.stdout == "### Added\n\n- A.\n") == (status == 0)


def test_each_disabled_rule_has_its_reason() -> None:
    """The reviewed rules that do not apply are listed with a sentence each."""
    ignored = SETTINGS["repo-review"]["ignore"]
    assert all(re.fullmatch(r"[A-Z]+\d+", rule) and len(reason) > 20 for rule, reason in ignored.items())


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    ["zizmor --offline --no-progress .github action.yml", "sp-repo-review ."],
    ids=["zizmor", "review"],
)
def test_reviewers_find_nothing(command: str) -> None:
    """The reviewers of workflows and of repositories have no finding, without the network."""
    program, *words = command.split()
    path = Path(sys.executable).parent / program
    if not path.exists():
        pytest.skip(f"{program} is not installed")
    done = subprocess.run([path, *words], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def steps_of(job: str) -> list[str]:
    """Return the scripts of a job of the release workflow, in order."""
    workflow = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text())
    return [step["run"] for step in workflow["jobs"][job]["steps"] if "run" in step]


@pytest.mark.nightly
def test_release_workflow_works_up_to_the_upload(tmp_path: Path) -> None:
    """Every script of the workflow ends with status 0 in a clone with the tag of the version."""
    clone, tag = tmp_path / "clone", f"v{PROJECT['version']}"
    subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
    changes = (clone / "CHANGELOG.md").read_text()
    if f"## {PROJECT['version']}" not in changes:  # a release gives the newest section its name
        (clone / "CHANGELOG.md").write_text(changes.replace("## Unreleased", f"## {PROJECT['version']}", 1))
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "env"], check=True)
    environment = {
        **os.environ,
        "PATH": f"{tmp_path / 'env/bin'}:{os.environ['PATH']}",
        "GITHUB_REF_NAME": tag,
    }
    for script in (*steps_of("build"), *steps_of("wheel")):
        done = subprocess.run(
            ["bash", "-eo", "pipefail", "-c", script],
            cwd=clone,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{script}\n{done.stdout}\n{done.stderr}"
