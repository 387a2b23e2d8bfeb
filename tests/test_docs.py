"""Every command, example and link in the README and the docs works."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import stat
import subprocess
import sys
from doctest import ELLIPSIS, NORMALIZE_WHITESPACE, OutputChecker
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

import bodycheck
from bodycheck._util.formatting import scientific
from bodycheck.adapters.engine_names import admit_file
from bodycheck.adapters.registry import get_adapter, optional_engines, program_of, registered, stated_by
from bodycheck.cli.commands import app
from bodycheck.recordings.column_map import read_map
from bodycheck.reference_impl.one_step_maps import named_map
from bodycheck.reports.gates.gate import read_gates, read_thresholds
from bodycheck.reports.gates.thresholds import THRESHOLD
from bodycheck.reports.run_files.trajectory_files import trajectory_table
from bodycheck.scenarios.reader import parse_members, parse_trees
from tests.helpers.doc_pages import (
    GENERATED,
    ROOT,
    Block,
    Command,
    blocks,
    commands,
    has_tests,
    pages,
    text_of,
)
from tests.helpers.engine_methods import expected_map
from tests.helpers.planted_faults import Faulty

NOT_RUN = {
    'python3 -m venv .venv && .venv/bin/pip install ".[engines,history]" && .venv/bin/bodycheck run': (
        "installs; takes minutes"
    ),
    'python3 -m venv .venv && .venv/bin/pip install -e ".[test]" && .venv/bin/python -m pytest': (
        "is these tests; CI runs it"
    ),
    'python3 -m venv .venv && .venv/bin/pip install ".[engines,history]"': (
        "installs; tools/release_trials.py does that"
    ),
    ". .venv/bin/activate": "needs the line before",
    'pip install "bodycheck[engines,history]"': "installs what a release publishes",
    '.venv/bin/pip install -e ".[bench]" && .venv/bin/python -m benchmarks '
    "&& .venv/bin/python -m benchmarks.readme": "installs, and measures speed for a quarter of an hour",
    "bodycheck run intermediate-axis --engine mujoco==3.17.0:rk4,mujoco==4.0.0:rk4": (
        "installs; tests/test_versions.py does that"
    ),
    "bodycheck versions mujoco --since 3.6": "installs, and takes minutes",
    "bodycheck versions mujoco --since 3.6 --measure order.orientation_error_rad": "the same",
    "bodycheck versions mujoco --since 3.6 --scenario spinning-box.toml --every": "the same",
    "bodycheck versions mujoco --since 3.6 --audit arm.urdf": "the same",
    "bodycheck run intermediate-axis --engine mujoco==3.17.0 --no-speed --out old": (
        "installs; tests/test_versions.py compares these two releases"
    ),
    "bodycheck run intermediate-axis --engine mujoco==4.0.0 --no-speed --out new": "the same",
    "bodycheck compare old new --fail-on worse": "needs the two before",
    "bodycheck environments make drake rapier-js": "installs",
    'bodycheck run full-tensor --engine "cmd:node docs/workers/m1.mjs,reference:m1" --no-speed': (
        "needs Node; tests/adapters/test_programs.py does that"
    ),
    "bodycheck run --out whole && python docs/report_picture.py whole": "takes minutes",
}
"""Commands that are shown but not run here, with the reason."""

LONG = tuple(
    f"docs/{name}.md"
    for name in (
        "add-an-engine",
        "clusters",
        "course",
        "diagnosis",
        "ensembles",
        "gates",
        "nightly",
        "recordings",
        "report",
        "start",
        "theory",
        "trees",
        "workers",
    )
)
"""Pages whose commands take long; smaller tests of the same commands run at each push."""

FILES = {
    "my-scenario.toml": ("docs/scenarios.md", "toml", 0),
    "my_loads.py": ("docs/scenarios.md", "python", 0),
    "my_shapes.py": ("docs/scenarios.md", "python", 1),
    "gates.toml": ("docs/gates.md", "toml", 0),
    "plate.toml": ("docs/start.md", "toml", 0),
    "arm.urdf": ("docs/audit.md", "xml", 0),
    "arm.usda": ("docs/audit.md", "text", 0),
    "finger.urdf": ("docs/audit.md", "xml", 1),
    "steady.csv": ("docs/questions.md", "text", 0),
    "sim.csv": ("docs/recordings.md", "text", 0),
    "log.csv": ("docs/recordings.md", "text", 1),
    "log-map.toml": ("docs/recordings.md", "toml", 0),
    "drift.py": ("docs/workers.md", "python", 0),
    "drifting.toml": ("docs/workers.md", "toml", 1),
}
"""The files that pages mention and show, by page, language and position of the block."""

OWN_ACTION = r"bodycheck/bodycheck@v\d+\.\d+\.\d+"
LANGUAGES = {
    "xml": "a model file: read by bodycheck",
    "sh": "its lines are run, and end with status 0",
    "console": "the same; what they print is compared but for white space, ... standing for anything",
    "python": "run as a script, or by pytest where it has tests",
    "yaml": "read as YAML; the bodycheck commands in it are there, with their options",
    "toml": "read by the reader of gates or of scenarios",
    "text": "not code, or a file that a command of its page reads",
}

MODULE = "bodycheck.pytest_plugin"
INSTALLED = any(point.value == MODULE for point in entry_points(group="pytest11"))
PROGRAMS = {
    "bodycheck": "-P -m bodycheck",  # like the installed command, without the working directory on the path
    "pytest": "-m pytest" if INSTALLED else f"-m pytest -p {MODULE}",
    "python": "",
}


def shown(page: str) -> list[Command]:
    """Return the commands of a page that the tests run."""
    of_tests = command_of_tests(page)
    return [command for command in commands(page) if command.line not in {*NOT_RUN, of_tests}]


def command_of_tests(page: str) -> str:
    """Return the command with which a page runs the tests that it shows."""
    lines = [command.line for command in commands(page) if command.line.startswith("pytest")]
    assert len(lines) <= 1, f"{page}: all tests of a page are run by one command"
    return lines[0] if lines and any(map(has_tests, blocks(page))) else "pytest"


def scripts(page: str) -> list[Block]:
    """Return the Python blocks of a page that are not tests."""
    return [block for block in blocks(page, "python") if not has_tests(block)]


def test_every_block_has_a_tested_language() -> None:
    """Each fenced block is run, parsed or marked as not code; all others are directives of Sphinx."""
    found = {block.language for page in pages() for block in blocks(page)}
    assert {language for language in found if not language.startswith("{")} <= set(LANGUAGES)


def test_commands_listed_as_not_run_are_shown() -> None:
    """Each command that is listed as not run appears on some page."""
    assert set(NOT_RUN) <= {command.line for page in pages() for command in commands(page)}


def test_prepared_files_are_named() -> None:
    """Each file that is created from a block of a page is named on some page."""
    for name in FILES:
        assert any(name in text_of(page) for page in pages())


# ------------------------------------------------------------------------------- the folder of a page


def part_stl() -> str:
    """Return a tetrahedron as an STL file."""
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    lines = ["solid part"]
    for facet in [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {corners[i]}" for i in facet)]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid part", ""])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the files that the pages mention, and commands bodycheck, pytest and python."""
    for name, (page, language, place) in FILES.items():
        (tmp_path / name).write_text(blocks(page, language)[place].text)
    (tmp_path / "part.stl").write_text(part_stl())
    truth = bodycheck.truth("intermediate-axis", [0.0, 1.0, 2.0]).trajectory
    trajectory_table(truth).to_csv(tmp_path / "my.csv", index=False)
    shutil.copy(ROOT / "tests/helpers/my_integrator.py", tmp_path)
    (tmp_path / "docs").mkdir()
    for name in ("small-body.toml", "report_picture.py"):
        shutil.copy(ROOT / "docs" / name, tmp_path / "docs")
    (tmp_path / "tools").mkdir()
    for name in ("trials.py", "worker_trials.py"):
        shutil.copy(ROOT / "tools" / name, tmp_path / "tools")
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, reported in PROGRAMS.items():
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {reported} "$@"\n')
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return tmp_path


def run_in(folder: Path, line: str) -> subprocess.CompletedProcess[str]:
    """Run a command line in this folder as a shell does."""
    environment = {
        **os.environ,
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
        "PYTEST_ADDOPTS": "-p no:cacheprovider",
    }
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", line],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,  # a page shows both streams, as a terminal does
        text=True,
        check=False,
    )


def check_commands(page: str, folder: Path) -> None:
    """Run the commands of a page in order; each must end with status 0 and print what the page shows."""
    for command in shown(page):
        done = run_in(folder, command.line)
        assert done.returncode == 0, f"{command.line}\n{done.stdout}"
        if command.prints is not None:
            printed = OutputChecker().check_output(
                command.prints, done.stdout, ELLIPSIS | NORMALIZE_WHITESPACE
            )
            assert printed, f"{command.line}\n{done.stdout}is not\n{command.prints}"


@pytest.mark.nightly
@pytest.mark.parametrize(
    "page",
    [page for page in pages() if shown(page)],
)
def test_commands_of_a_page_work(page: str, folder: Path) -> None:
    """All commands of a page work when run in order in a folder with the files of the docs."""
    needed = " ".join(command.line for command in shown(page))
    if "pybullet" in needed:  # no wheels for later versions of Python
        pytest.importorskip("pybullet")
    if "report_picture.py" in needed and shutil.which("chromium") is None:
        pytest.skip("no Chromium on the path")
    check_commands(page, folder)
    if page == "docs/gates.md":
        gates = blocks(page, "toml")[0].text
        assert {"gates.xml", "gates.json", "my-run"} <= {path.name for path in folder.iterdir()}
        kept = [gate.reason for gate in read_gates(folder / "gates.toml")]
        assert kept == re.findall('reason = "(.*)"', gates)


def write_tests(page: str, folder: Path) -> int:
    """Write the Python blocks of a page that contain tests to files; return the number of tests."""
    tests = [block.text for block in blocks(page, "python") if has_tests(block)]
    for place, text in enumerate(tests):
        (folder / f"test_block_{place}.py").write_text(text)
    return sum(len(re.findall(r"^def test_", text, flags=re.MULTILINE)) for text in tests)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.nightly if page in LONG else ())
        for page in pages()
        if any(map(has_tests, blocks(page)))
    ],
)
def test_tests_of_a_page_pass(page: str, folder: Path) -> None:
    """The tests in each Python block pass, with the command of the page if it shows one."""
    wanted = write_tests(page, folder)
    done = run_in(folder, command_of_tests(page))
    assert done.returncode == 0, done.stdout
    passed = re.search(r"^=* ?(\d+) passed in", done.stdout, flags=re.MULTILINE)
    assert passed is not None, done.stdout
    assert int(passed[1]) >= wanted


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("page", [page for page in pages() if scripts(page)])
def test_python_of_a_page_works(page: str, folder: Path) -> None:
    """All other Python blocks of a page, in order, form a script that ends with status 0."""
    (folder / "page.py").write_text("\n".join(block.text for block in scripts(page)))
    done = run_in(folder, "python page.py")
    assert done.returncode == 0, done.stdout


BODY = re.compile(r"^\[body\]\n.*?\n\n", flags=re.DOTALL | re.MULTILINE)


def a_scenario_with(text: str) -> str:
    """Return a scenario: the first one of docs/scenarios.md with a part of a file added or inserted."""
    first = blocks("docs/scenarios.md", "toml")[0].text
    if 'kind = "pivot"' in text:  # the centre of mass cannot start at rest if the body rotates about a pivot
        first = re.sub(r"^velocity_m_s.*\n", "", first, flags=re.MULTILINE)
    if text.startswith("name = "):
        return text
    return BODY.sub(text + "\n", first) if text.startswith("[body]") else first + text


@pytest.mark.parametrize(
    "block", [block for page in pages() for block in blocks(page, "toml")], ids=lambda block: block.page
)
def test_toml_of_the_docs_is_accepted(block: Block, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each block of gates, thresholds or programs is valid, and so are scenarios with their tables."""
    monkeypatch.chdir(folder)
    if "[[change]]" in block.text:
        (folder / "shown.toml").write_text(block.text)
        assert len(read_thresholds(folder / "shown.toml", THRESHOLD).of_measure) == 1
        return
    if "[[gate]]" in block.text:
        (folder / "shown.toml").write_text(block.text)
        assert len(read_gates(folder / "shown.toml")) == block.text.count("[[gate]]")
        return
    if "euler_1_rad" in block.text:
        (folder / "shown.toml").write_text(block.text)
        assert read_map([folder / "shown.toml"]).euler == "ZYX"
        return
    if "[[body]]" in block.text:
        assert len(parse_trees(block.text, block.page, folder)) == 1
        return
    if "[engines." in block.text:
        (folder / "engines.toml").write_text(block.text)
        with registered():
            admit_file(folder / "engines.toml", allow_code=True)
            names = re.findall(r"^\[engines\.(.+)\]$", block.text, re.MULTILINE)
            assert names
            assert all(program_of(name) is not None for name in names)
        return
    whole = a_scenario_with(block.text)
    assert block.text in whole
    members = parse_members(whole, block.page, folder, allow_code=True)
    forced = "[[forcing]]" in whole
    assert all(bool(scenario.scene.loads) == forced for scenario in members.values())


# ------------------------------------------------------------------------------------- within the text

INLINE = re.compile(r"`((?:bodycheck|pytest|python) [^`\n]+)`")


def inline_commands() -> list[str]:
    """Return the commands within the text of the pages, including those that are shown but not run."""
    within = {line for page in pages() for line in INLINE.findall(text_of(page))}
    return sorted(within | {line for line in NOT_RUN if "&&" not in line and line.startswith("body")})


@pytest.mark.slow(after=10)
@pytest.mark.nightly(after=17)
@pytest.mark.parametrize("line", [line for line in inline_commands() if line.startswith("bodycheck ")])
def test_command_within_the_text_has_existing_options(line: str) -> None:
    """The command and its options exist; values may be omitted or written in capitals."""
    check_options(line)


def check_options(line: str) -> None:
    """Check that a bodycheck command and each of its options exist."""
    words = shlex.split(line)[1:]
    command: Any = typer.main.get_command(app)
    for word in words:
        if word.startswith("-") or not hasattr(command, "commands"):
            break
        command = command.commands[word]
    known = {option for parameter in command.params for option in parameter.opts}
    assert {word for word in words if re.match(r"--[a-z]", word)} <= known


@pytest.mark.parametrize(
    "block", [block for page in pages() for block in blocks(page, "yaml")], ids=lambda block: block.page
)
def test_steps_of_a_workflow_are_steps(block: Block) -> None:
    """Each step of a workflow runs something, and the bodycheck commands in it exist."""
    content = yaml.safe_load(block.text)
    steps = (
        content
        if isinstance(content, list)
        else [s for job in content.get("jobs", {}).values() for s in job["steps"]]
    )
    for step in steps:
        assert "run" in step or re.fullmatch(rf"[\w-]+/[\w-]+@[0-9a-f]{{40}}|{OWN_ACTION}", step["uses"])
        for line in step.get("run", "").splitlines():
            if line.strip().startswith("bodycheck "):
                check_options(re.split(r">>|\|\|", line)[0])


@pytest.mark.parametrize("line", [line for line in inline_commands() if not line.startswith("bodycheck ")])
def test_command_within_the_text_names_existing_files(line: str) -> None:
    """Tests and scripts that the text names exist in the repository."""
    named = [word for word in shlex.split(line)[1:] if "/" in word]
    assert all((ROOT / word).exists() for word in named)


LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page and of what it includes: headings as a Markdown viewer converts them."""
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"^```\{include\} (\S+)", text, flags=re.MULTILINE):
        text += (page.parent / name).read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", pages())
def test_links_lead_to_existing_files_and_headings(page: str) -> None:
    """Links into the repository lead to existing files, which Sphinx does not check."""
    for name, anchor in LINK.findall(text_of(page)):
        target = (ROOT / page).parent / name if name else ROOT / page
        if GENERATED & set(target.parts):
            continue  # Sphinx makes these pages, and checks links to them
        assert target.exists(), name
        assert not anchor or anchor in anchors(target), f"{name}#{anchor}"


CODE = re.compile(r"^\*Code:\*(.*?)(?=\n\n)", flags=re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", ["docs/theory.md", "docs/truth.md"])
def test_code_named_by_a_page_exists_and_is_documented(page: str) -> None:
    """Each name after *Code:* exists in its package, is documented, and its module is in the interface."""
    interface = text_of("docs/api.md")
    paragraphs = CODE.findall(text_of(page))
    assert len(paragraphs) >= 3
    for name in re.findall(r"`([a-z_.]+\.[\w.]+)`", " ".join(paragraphs)):
        room = "scenarios" if name.startswith("mass_properties.") else "reference_impl"
        module, found = resolved(f"bodycheck.{room}.{name}")
        assert found.__doc__, name
        assert f".. automodule:: {module}\n" in interface, name


def resolved(name: str) -> tuple[str, object]:
    """Return the module at the beginning of a dotted name, and the object that the whole name refers to."""
    parts = name.split(".")
    for end in range(len(parts) - 1, 0, -1):
        module = ".".join(parts[:end])
        if (ROOT / module.replace(".", "/")).is_dir() or (ROOT / f"{module.replace('.', '/')}.py").exists():
            found: object = __import__(module, fromlist=["_"])
            for part in parts[end:]:
                found = getattr(found, part)
            return module, found
    raise AssertionError(f"no module: {name}")


@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "dart", "reference", *optional_engines()])
def test_table_of_methods_equals_the_adapter(engine: str) -> None:
    """The page of an engine is identical to the output of docs/method_tables.py for its adapter."""
    if engine == "pybullet":  # no wheels for later versions of Python
        pytest.importorskip("pybullet")
    tables = runpy.run_path(str(ROOT / "docs/method_tables.py"))
    page = text_of(f"docs/engines/{engine}.md")
    adapter = stated_by(engine) or get_adapter(engine)
    assert tables["with_tables"](page, engine, adapter.methods.values()) == page


@pytest.mark.nightly
@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "dart", *optional_engines()])
def test_formula_that_a_page_states_is_the_map_that_was_measured(engine: str) -> None:
    """The fingerprint in the results of a page names the stated map, if it was measured."""
    if engine == "pybullet":  # no wheels for later versions of Python
        pytest.importorskip(engine)
    methods = (stated_by(engine) or get_adapter(engine)).methods
    results = text_of(f"docs/engines/{engine}.md").partition("<!-- measured -->")[2]
    measured = dict(re.findall(r"^\| `(.+?)` \| (.*?) \| ", results.replace(r"\|", "|"), re.MULTILINE))
    assert measured
    for name, found in measured.items():
        expected = expected_map(methods[name])
        assert found.startswith(expected) or (not found and named_map(expected) is None), name


@pytest.mark.nightly
def test_pages_of_engines_are_written_from_a_run() -> None:
    """The tables have the orders, floors, refusals and faults of a run; a second writing changes nothing."""
    write = runpy.run_path(str(ROOT / "docs/engine_results.py"))
    with registered(Faulty("m1")):
        run = bodycheck.run(
            ["free-flight", "heavy-top"],
            engines=["reference:rk4-f32", "faulty-m1:sound", "faulty-m1:no-gyroscopic-term"],
            speed=False,
        )
    engines = write["measured"]([run])
    assert {name: list(methods) for name, methods in engines.items()} == {
        "reference": ["rk4-f32"],
        "faulty-m1": ["sound", "no-gyroscopic-term"],
    }
    page = "before\n<!-- measured -->\nold\n<!-- end of measured -->\nafter\n"
    written = {
        name: write["with_measured"](page, list(write["engine_lines"](methods.values())))
        for name, methods in engines.items()
    }
    assert "old" not in written["faulty-m1"]
    assert write["with_measured"](written["reference"], ["x"]) == page.replace("old", "x")

    rows = run.methods[run.methods["quantity"] == "orientation_error_rad"]
    rows = rows[rows["scenario"] == "free-flight"].set_index("method")
    single = rows.loc["rk4-f32"]
    figures = [scientific(single[name]) for name in ("least_error", "measured_floor", "predicted_floor")]
    assert (
        f"| {figures[0]} at {single['best_dt_s']:g} s | {figures[1]} | {figures[2]} |" in written["reference"]
    )
    assert "Findings: none." in written["reference"]
    assert "Not represented: none." in written["reference"]
    sound = f"converges | {rows.loc['sound']['order']:.2f} |"
    assert sound in written["faulty-m1"]
    assert "\n- no pivot\n" in written["faulty-m1"]
    (fault,) = {line for line in written["faulty-m1"].splitlines() if "omega x I omega is missing" in line}
    assert fault.startswith("- `no-gyroscopic-term`: orientation_error_rad does not converge")
    overview = list(write["overview_lines"](engines))
    assert [line.split(" | ")[0] for line in overview[2:]] == ["| reference", "| faulty-m1"]
    assert overview[3].endswith(" | no pivot | no-gyroscopic-term |")


@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "dart", "reference", *optional_engines()])
def test_list_of_engines_has_each_with_the_version_of_its_page(engine: str) -> None:
    """The measured values on the engine's page and in the list of all engines are of the same version."""
    page, listed = text_of(f"docs/engines/{engine}.md"), text_of("docs/engines.md")
    version = re.search(r"<!-- measured -->\nVersion (\S+) on ", page)
    assert version is not None
    assert re.search(rf"^\| {engine} \| {re.escape(version[1])} \| ", listed, re.MULTILINE)


# ---------------------------------------------------------------------------------- published findings


@pytest.mark.slow
def test_readme_findings_are_those_of_a_run() -> None:
    """The numbers in the table equal those of a run, to the digits shown."""
    found = bodycheck.run(
        ["intermediate-axis"],
        engines=["mujoco:euler", "mujoco:implicit", "mujoco:rk4", "dart", "reference:lie-euler"],
        dt_s=[1e-2, 1e-3],
        speed=False,
    ).results.set_index(["method", "dt_s"])
    rows = {
        "euler": ("1.41e-2 rad", "1.3e-3", 1e-3),
        "semi-implicit": ("1.41e-2 rad", "1.3e-3", 1e-3),
        "implicit": ("1.42e-2 rad", "1.4e-3", 1e-3),
        "rk4": ("2.1e-9 rad at 1e-2 s", "1.5e-9", 1e-2),
        "lie-euler": ("1.1 rad", "below 1e-14", 1e-3),
    }
    page = text_of("README.md")
    for method, (error, drift, dt_s) in rows.items():
        assert re.search(
            rf"^\|[^\n]*\| {re.escape(error)} \|[^\n]*\| {re.escape(drift)} \|$", page, re.MULTILINE
        )
        measured = found.loc[(method, dt_s)]
        assert measured["orientation_error_rad"] == pytest.approx(float(error.split()[0]), rel=0.04)
        if drift.startswith("below"):  # round-off, which differs between machines
            assert 0.0 < measured["angular_momentum_drift"] < float(drift.removeprefix("below "))
        else:
            assert measured["angular_momentum_drift"] == pytest.approx(float(drift), rel=0.15)


@pytest.mark.slow
def test_small_body_behaves_as_the_readme_states() -> None:
    """PyBullet does not converge on the small body in maximal coordinates, but does in reduced ones."""
    pytest.importorskip("pybullet")
    found = bodycheck.run([ROOT / "docs/small-body.toml"], engines=["pybullet"], speed=False).methods
    verdicts = found[found["quantity"] == "orientation_error_rad"].set_index("method")["verdict"]
    assert verdicts.to_dict() == {"multibody": "converges", "maximal": "does-not-converge"}


def test_the_ten_steps_of_a_case_are_where_contributing_names_them() -> None:
    """Each step names what its file defines; together the files stay short enough to be read in an hour."""
    page = (ROOT / "CONTRIBUTING.md").read_text()
    steps = re.findall(r"^\| (\d+) \| .* \| `(\w+)` \| `([\w/.]+)` \|$", page, re.MULTILINE)
    assert [int(number) for number, _, _ in steps] == [*range(1, 11)]
    texts = {file: (ROOT / file).read_text() for _, _, file in steps}
    assert len(texts) == 10
    assert sum(text.count("\n") for text in texts.values()) <= 3000
    for _, name, file in steps:
        assert re.search(rf"^(def|class) {name}\b|^{name}(: | = )", texts[file], re.MULTILINE), (name, file)
    assert all((ROOT / "bodycheck" / room).is_dir() for room in re.findall(r"`(reports/\w+/)`", page))


def test_every_array_of_the_notation_exists() -> None:
    """Each row names a class of the reference implementation and one of its fields or properties."""
    named = re.findall(r"`([A-Z]\w+)\.(\w+)`", (ROOT / "docs/notation.md").read_text())
    assert len(named) > 20
    found: dict[str, str] = {}
    for file in sorted((ROOT / "bodycheck/reference_impl").rglob("*.py")):
        parts = re.split(r"^class (\w+)", file.read_text(), flags=re.MULTILINE)[1:]
        found |= dict(zip(parts[::2], parts[1::2], strict=True))
    for owner, name in named:
        assert re.search(rf"^    (def )?{name}\b", found[owner], re.MULTILINE), (owner, name)
