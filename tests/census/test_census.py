"""The findings, what confirms them, and the pages that are made of them."""

from __future__ import annotations

import ast
import builtins
import json
import random
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from bodycheck._util.errors import InputError
from bodycheck.audit.audit import LintFinding
from bodycheck.cli.commands import app
from census.finding import DRIVERS, FINDINGS, INPUTS, KINDS, Finding, chosen, read_findings
from census.imports import counted, kind_of_cause, kind_of_message, read_imports
from census.models import audits_of, confirmation, read_errors
from census.numbers import NUMBERS, digits
from census.page import report_of, write_pages
from census.releases import HEADER, add_new_releases, changes, read_releases, spans
from census.reproduce import Compared, looked_up, reproduce
from census.standalone import program

ALL = read_findings()
DOCS = Path(__file__).parents[2] / "docs"
COMMANDS = get_command(app).commands  # type: ignore[attr-defined]


@pytest.mark.parametrize("finding", ALL.values(), ids=lambda one: one.name)
def test_command_parses_and_names_a_release(finding: Finding) -> None:
    """bodycheck's own parser accepts the command, whose engines are pinned where they can be."""
    if not finding.command:
        return
    _, name, *words = shlex.split(finding.command)
    COMMANDS[name].make_context(name, list(words))
    pins = re.findall(rf"{finding.engine}(==)?", finding.command)
    assert pins
    assert all(pins) or finding.environment == finding.engine
    assert set(finding.inputs) == {word for word in words if (INPUTS / word).is_file()}


def experiments() -> Iterator[str]:
    """Yield MODULE EXPERIMENT of everything that the drivers can run."""
    for path in DRIVERS.glob("with_*.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                yield f"{path.stem} {node.name}"
    javascript = DRIVERS / "javascript.mjs"
    for name in re.findall(r"^  async (\w+)\(", javascript.read_text(), flags=re.MULTILINE):
        yield f"{javascript.name} {name}"


def test_each_experiment_and_input_belongs_to_a_finding() -> None:
    """Every driver that a finding names exists, and nothing here is used by no finding and no number."""
    assert {one.driver for one in ALL.values() if one.driver} == set(experiments())
    used = {name for one in ALL.values() for name in one.inputs}
    cases = {f"{name}.toml" for name in tomllib.loads(NUMBERS.read_text())}
    assert used | cases == {path.name for path in INPUTS.iterdir()}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("kind", "bug"),
        ("expected", ""),
        ("figures", {}),
        ("driver", ""),
        ("inputs", ("absent.toml",)),
        ("upstream", "none found"),
    ],
)
def test_incomplete_finding_is_refused(field: str, value: object) -> None:
    """An unknown kind, an empty field, a command without figures, one way alone, an absent input."""
    finding = ALL["pybullet-damping"]
    with pytest.raises(InputError, match=r"census/findings/pybullet\.toml: pybullet-damping: "):
        replace(finding, **{field: value})  # type: ignore[arg-type]


def test_unknown_field_or_finding_is_refused(tmp_path: Path) -> None:
    """A table with a field that does not exist is refused with its file, and so is an unknown name."""
    text = (FINDINGS / "pinocchio.toml").read_text()
    (tmp_path / "pinocchio.toml").write_text(text.replace("kind =", "sort ="))
    with pytest.raises(InputError, match=r"pinocchio\.toml: pinocchio-depth-first: .*sort"):
        read_findings(tmp_path)
    with pytest.raises(InputError, match="neither a finding nor an engine"):
        chosen(ALL, ["absent"])
    assert {one.engine for one in chosen(ALL, ["pinocchio", "dart-sdf-frame"])} == {"pinocchio", "dart"}


def test_figure_that_differs_is_not_reproduced() -> None:
    """A number agrees up to 2 %, a text if it is contained, and nothing agrees with what is missing."""
    assert Compared("", 0.37, 0.3684).agrees
    assert not Compared("", 0.37, 0.3601).agrees
    assert Compared("", "mimic dropped", "mimic dropped: 1 drive in the file").agrees
    assert not any(Compared("", stated, None).agrees for stated in (0.0, 1.0, "text"))
    assert not Compared("", "1", True).agrees
    assert not Compared("", 1.0, True).agrees
    answer = {"a": [{"name": "x", "b": 1.5}, {"name": "y", "causes": ["one", "two"]}]}
    assert looked_up(answer, "a/name=y/causes") == "one; two"
    assert looked_up(answer, "a/0/b") == 1.5
    assert looked_up(answer, "a/name=z/b") is None
    assert looked_up(answer, "a/7/b") is None
    assert looked_up(answer, "a/0/b/c") is None


PROGRAMS = {
    one.name: (DRIVERS / f"{one.driver.partition(' ')[0]}.py", one.driver.partition(" ")[2])
    for one in ALL.values()
    if ".mjs" not in one.driver
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_program_of_a_report_defines_what_it_uses(name: str) -> None:
    """The program needs no other file of the drivers, and defines nothing that it does not use."""
    tree = ast.parse(program(*PROGRAMS[name]))
    names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
    read = {node.id for node in names if isinstance(node.ctx, ast.Load)}
    own = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    imported = {
        (one.asname or one.name).partition(".")[0]
        for node in tree.body
        if isinstance(node, ast.Import | ast.ImportFrom)
        for one in node.names
    }
    given = {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    stored = {node.id for node in names if isinstance(node.ctx, ast.Store)}
    assert read <= own | imported | given | stored | set(dir(builtins))
    assert "exact" not in {getattr(node, "module", "") for node in tree.body}
    assert own | imported - {"annotations"} <= read


def test_program_of_a_report_prints_the_figures() -> None:
    """It runs without the folder of the drivers, as a maintainer would run it."""
    done = subprocess.run(
        [sys.executable, "-c", program(*PROGRAMS["mujoco-spec-frame"])],
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == pytest.approx(ALL["mujoco-spec-frame"].driver_figures, rel=1e-6)


def test_docs_name_findings_that_exist() -> None:
    """The public bugs that docs/trees.md lists are findings, and cite the same issue."""
    table = (
        (DOCS / "trees.md").read_text(encoding="utf-8").partition("| public issue |")[2].partition("\n\n")[0]
    )
    rows = re.findall(r"^\| \[.+?\]\((\S+)\).*?\| `([\w-]+)`", table, flags=re.MULTILINE)
    assert rows
    assert {name: ALL[name].upstream for _, name in rows} == {name: issue for issue, name in rows}


@pytest.mark.nightly
def test_command_and_driver_of_a_finding_are_run() -> None:
    """MuJoCo as installed merges the root link; a finding with other figures than those printed differs."""
    finding = ALL["mujoco-root-link"]
    here = replace(
        finding,
        command=finding.command.replace("mujoco==4.0.0", "mujoco"),
        figures={name.replace("mujoco==4.0.0", "mujoco"): value for name, value in finding.figures.items()},
        environment="mujoco",
    )
    assert [one.agrees for one in reproduce(here)] == [True] * 4
    wrong = replace(here, figures=dict.fromkeys(here.figures, "nothing"), driver_figures=(2.0, 1.0))
    assert [one.agrees for one in reproduce(wrong)] == [False] * 4


@pytest.mark.nightly
def test_sample_of_ten_is_reproduced_in_an_empty_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten findings are seen in environments that are made for them."""
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path))
    here = [one for one in ALL.values() if "==" in one.environment]
    for finding in random.Random(1).sample(here, 10):
        assert [one for one in reproduce(finding) if not one.agrees] == [], finding.name


def test_impossible_tensor_is_confirmed_exactly(tmp_path: Path) -> None:
    """tr(I)/2 - I has a negative minor exactly where the moments break the triangle inequality."""
    rng = np.random.default_rng(1)
    for k in range(40):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        third = 3.0 + (0.01 if k % 2 else -0.01)
        tensor = axes @ np.diag([1.0, 2.0, third]) @ axes.T
        entries = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(tensor[i, j])) for i in range(3) for j in range(i, 3)}
        words = " ".join(f'{key}="{value}"' for key, value in entries.items())
        path = tmp_path / "model.urdf"
        inertial = f'<inertial><mass value="1"/><inertia {words}/></inertial>'
        path.write_text(f'<robot name="r"><link name="a">{inertial}</link></robot>')
        triangle = LintFinding("triangle-inequality", "error", "certain", "model.urdf", 1, "a", "")
        assert bool(confirmation(path, triangle)) == bool(k % 2)


@pytest.mark.slow
def test_imports_are_counted_by_state_and_cause(tmp_path: Path) -> None:
    """A row without a cause counts all in a state; causes are counted without numbers, names and issues."""
    link = (
        '<link name="{}"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="{}" {}/></inertial></link>'
    )
    zeros = 'ixy="0" ixz="0" iyz="0"'
    for name, moments in (("a", (1.0, 1.5)), ("b", (1.1,))):
        links = "".join(link.format(f"l{k}", one, zeros) for k, one in enumerate(moments))
        joint = '<joint name="j" type="fixed"><parent link="l0"/><child link="l1"/></joint>' * (
            len(moments) - 1
        )
        (tmp_path / f"{name}.urdf").write_text(f'<robot name="r">{links}{joint}</robot>')
    (tmp_path / "part.xml").write_text("<mujocoinclude/>")
    rows = counted("p", "1", audits_of(tmp_path))
    states = {
        (one.what, one.state): (one.count, one.files)
        for one in rows
        if one.importer == "pybullet:default" and not one.cause
    }
    assert states == {("file", "read"): (2, 2), ("link", "differs"): (3, 2), ("joint", "agrees"): (1, 1)}
    causes = {one.cause: one.count for one in rows if one.importer == "pybullet:default" and one.cause}
    assert causes == {"tensor discarded": 3}
    assert (
        kind_of_cause("limits times 57.3, as degrees for radians: [1] held")
        == "limits times N, as degrees for radians"
    )
    assert (
        kind_of_message("ValueError: cannot open 'a/b.stl' Element 'x', line 3") == "ValueError: cannot open"
    )


def test_errors_in_models_are_of_known_packages() -> None:
    """Each row names package, version, file, line, link and rule, and why the numbers are impossible."""
    errors = read_errors()
    assert len(errors) >= 25
    assert all(one.confirmed and one.file and one.line and one.link and one.version for one in errors)


@pytest.mark.parametrize(
    ("published", "difference", "expected"),
    [
        ("0.373034285", "0", "9 of 9"),
        ("0.373034285", "4e-10", "9 of 9"),
        ("0.373034285", "6e-10", "8 of 9"),
        ("-929.47789677244", "2e-6", "8 of 14"),
        ("1.00", "3", "0 of 3"),
    ],
)
def test_digits_that_agree(published: str, difference: str, expected: str) -> None:
    """A digit agrees if the difference is at most half a unit of it."""
    assert digits(published, Decimal(difference)) == expected


def test_changed_release_is_named() -> None:
    """Another map or order is a change; a new method is none, nor is a map that is one of many candidates."""
    rows = [
        dict(zip(HEADER, ("e", release, method, found, order, "1e-3", "converges"), strict=True))
        for release, method, found, order in (
            ("1", "a", "M1", "1.0"),
            ("2", "a", "M1", "1.0"),
            ("2", "b", "M2", "1.0"),
            ("3", "a", "M1", "2.0"),
            ("3", "b", "M2 or 5 others", "1.0"),
            ("4", "b", "RK4 or 11 others", "1.0"),
        )
    ]
    assert list(changes(rows)) == [("e", "3", "e 3, `a`: order 1.0 -> 2.0")]
    assert read_releases()


def test_releases_without_a_change_share_a_row() -> None:
    """A stretch ends where a map changes, and where a release between was not measured for a method."""
    rows = [
        dict(zip(HEADER, ("e", release, method, found, "1.0", error, verdict), strict=True))
        for release, method, found, error, verdict in (
            ("1", "a", "M1", "1e-3", "converges"),
            ("2", "a", "M1", "2e-3", "converges"),
            ("2", "b", "M1", "1e-3", "converges"),
            ("3", "", "", "", "does not run"),
            ("4", "a", "M1", "1e-3", "converges"),
            ("5", "a", "M2", "1e-3", "converges"),
        )
    ]
    found = [(row["release"], row["method"], row["map"], row["error at 1e-3 s, rad"]) for row in spans(rows)]
    assert found == [
        ("3", "", "", ""),
        ("1 to 2", "a", "M1", "2e-3"),
        ("4", "a", "M1", "1e-3"),
        ("5", "a", "M2", "1e-3"),
        ("2", "b", "M1", "1e-3"),
    ]


def test_release_is_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """New and older releases are added in order; of those with rows, only the last that failed again."""
    measured = []

    def measure(engine: str, release: str) -> list[dict[str, str]]:
        measured.append(release)
        values = (engine, release, "a", "M1" if release < "3" else "M2", "1.0", "1e-3", "converges")
        return [dict(zip(HEADER, values, strict=True))]

    table = tmp_path / "releases.csv"
    header = ",".join(f'"{name}"' for name in HEADER)
    table.write_text(f"{header}\ne,2,,,,,does not run: no numpy\nother,1,a,M1,1.0,1e-3,converges\n")
    monkeypatch.setattr("census.releases.MEASURED", table)
    monkeypatch.setattr("census.releases.measure", measure)
    monkeypatch.setattr(
        "census.releases.releases", lambda _, since, __: [one for one in "1234" if one >= since]
    )
    monkeypatch.setattr("census.releases.read_releases", lambda: read_releases(table))
    assert add_new_releases(["e"], None) == ["e 3, `a`: map M1 -> M2"]
    assert measured == ["2", "3", "4"]
    assert add_new_releases(["e"], "1") == []
    assert measured == ["2", "3", "4", "1"]
    rows = [row for row in read_releases(table) if row["engine"] == "e"]
    assert [row["release"] for row in rows] == ["1", "2", "3", "4"]
    with pytest.raises(InputError, match="absent has no rows"):
        add_new_releases(["absent"], None)


def plain(text: str) -> str:
    """Return Markdown without the escapes that keep elements and products as they are."""
    return text.replace("&lt;", "<").replace("\\*", "*")


@pytest.mark.slow
def test_pages_have_every_finding(tmp_path: Path) -> None:
    """The index counts and links each finding, its engine's page has all of it, and old pages are removed."""
    (tmp_path / "withdrawn-engine.md").write_text("old")
    written = {path.stem: plain(path.read_text()) for path in write_pages(tmp_path)}
    assert {path.stem for path in tmp_path.iterdir()} == set(written)
    assert f"{len(ALL)} findings" in written["index"]
    sections = written["index"].split("\n## ")[1:]
    for kind, section in zip(KINDS, sections, strict=False):
        names = {one.name for one in ALL.values() if one.kind == kind}
        assert set(re.findall(r"\.md#([\w-]+)\)", section)) == names
        assert f"\n{len(names)} in which" in section
    assert [text for *_, text in changes(read_releases())] == re.findall(
        "^- (.+)$", written["releases"], re.M
    )
    for one in ALL.values():
        assert f"({one.engine}.md#{one.name})" in written["index"]
        assert one.expected in written[one.engine]
        report = plain(report_of(one))
        assert one.found in report
        assert f"{one.driver.partition(' ')[2]}()" in report
        assert ("This is public already" in report) == one.is_public
        assert all((INPUTS / name).read_text().rstrip() in report for name in one.inputs)
        assert (
            f"<{one.upstream}>" in written[one.engine]
            if one.is_public
            else one.searched in written[one.engine]
        )
    assert all(count.cause in written["models"] for count in read_imports())
