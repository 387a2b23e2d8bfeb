"""The version matrix and the search for the release in which a measure changed, on a toy engine."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import bodycheck
from bodycheck._util.errors import InputError, UnavailableError
from bodycheck.adapters import registry
from bodycheck.adapters.contract import Control, Engine, Method
from bodycheck.adapters.versions import environments, uv
from bodycheck.adapters.versions.uv import releases
from bodycheck.adapters.workers.engine_pool import announced
from bodycheck.reports.comparison.compare import renamed
from bodycheck.reports.comparison.release_results import Found
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.runs import version_search
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import Request
from bodycheck.runs.selection import Selection
from bodycheck.runs.version_search import search
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.gate_tables import make_tables
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.local_package_index import write_needed, write_toy, write_wheel

STEPS = [2e-2, 1e-2, 5e-3, 2e-3]
DT = ",".join(map(str, STEPS))
RELEASES = {"1.0": "m1", "1.0.5": "rk4", "1.1": "m1", "1.9": "m1", "1.10": "rk4", "2.0": "rk4"}
BROKEN = "1.5"


@pytest.fixture(scope="module")
def links(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of toy releases of order 1, and of order 4 in 1.0.5 and from 1.10 on; one is broken."""
    folder = tmp_path_factory.mktemp("links")
    write_needed(folder)
    for release, method in RELEASES.items():
        write_toy(folder, release, method)
    points = "[bodycheck.adapters]\ntoy = toy_engine:Toy\n"
    write_wheel(folder, "toy_engine", BROKEN, {"toy_engine.py": "raise RuntimeError('spoilt')\n"}, points)
    write_toy(folder, "2.1rc1", "rk4")  # a pre-release
    write_toy(folder, "3.0", "rk4", announced="2.9")
    return folder


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the environments, which all tests share."""
    return tmp_path_factory.mktemp("home")


@pytest.fixture
def toy(links: Path, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install the toy's release 2.0 here, and let uv find its releases without a network."""
    try:
        uv.uv_program()
    except UnavailableError as error:
        pytest.skip(str(error))
    installed = tmp_path / "installed"
    zipfile.ZipFile(links / "toy_engine-2.0-py3-none-any.whl").extractall(installed)
    monkeypatch.syspath_prepend(str(installed))
    nothing = tmp_path / "no-index"
    nothing.mkdir()
    monkeypatch.setenv("UV_DEFAULT_INDEX", nothing.as_uri())
    monkeypatch.setenv("UV_FIND_LINKS", str(links))
    monkeypatch.setattr(environments, "cache_dir", lambda: home)
    registry._plugged_in.cache_clear()
    yield
    registry._plugged_in.cache_clear()


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, str, str]]:
    """Return a function that runs a command in this process in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def requested(*words: str) -> tuple[int, str, str]:
        done = run_bodycheck(tmp_path, *words)
        return done.returncode, done.stdout, done.stderr

    return requested


CONFIGURATIONS = {"uv.toml": "{line}", "pyproject.toml": "[tool.uv]\n{line}"}


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_configuration_of_the_working_directory_is_ignored(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """Configuration files of a checkout are ignored, as they may name another index; the user's is used."""
    monkeypatch.delenv("UV_FIND_LINKS")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    checkout, other = tmp_path / "checkout", tmp_path / "other"
    for folder in (checkout, other, tmp_path / "config/uv"):
        folder.mkdir(parents=True)
    write_toy(other, "9.9", "rk4")
    line = f'find-links = ["{other}"]\n'
    (checkout / name).write_text(CONFIGURATIONS[name].format(line=line))
    monkeypatch.chdir(checkout)
    with expected_message.raises(InputError):
        releases("toy", "1.0", None)
    (tmp_path / "config/uv/uv.toml").write_text(line)
    assert releases("toy", "1.0", None) == ("9.9",)


@pytest.mark.nightly
@pytest.mark.usefixtures("toy")
def test_versions_are_engines_of_their_own() -> None:
    """Each version is run with its own code and appears in every table next to the installed one."""
    run = bodycheck.run(
        ["intermediate-axis"], engines=["toy==1.0", "toy == 2.0:m", "toy"], dt_s=STEPS, speed=False
    )
    orders = run.methods[run.methods["quantity"] == "orientation_error_rad"].set_index("engine")["order"]
    assert orders.round(1).to_dict() == {"toy==1.0": 1.0, "toy==2.0": 4.0, "toy": 4.0}
    versions = run.results.drop_duplicates("engine").set_index("engine")["engine_version"]
    assert versions.to_dict() == {"toy==1.0": "1.0", "toy==2.0": "2.0", "toy": "2.0"}
    first = run.results["reproduce"].iloc[0]
    assert first == "bodycheck run intermediate-axis --engine toy==1.0:m --dt 0.02"
    assert list(run.manifest["engines"]) == ["toy==1.0", "toy==2.0", "toy"]


@pytest.mark.nightly
@pytest.mark.usefixtures("toy")
def test_two_versions_are_compared_under_one_name() -> None:
    """Every table and case uses the common name, because otherwise nothing could be compared."""
    run = bodycheck.run(["intermediate-axis"], engines=["toy==1.0"], dt_s=STEPS, speed=False)
    tables = renamed(run, {"toy==1.0": "toy"})
    assert {*tables.results["engine"]} == {*tables.methods["engine"]} == {"toy"}
    assert {case.columns["engine"] for case in tables.cases} == {"toy"}


@pytest.mark.nightly
@pytest.mark.usefixtures("toy")
def test_speeds_are_measured_in_the_versions_environment() -> None:
    """A case of a pinned version is timed like any other case."""
    run = bodycheck.run(["intermediate-axis"], engines=["toy==1.0"], dt_s=[1e-2])
    assert (run.results["cpu_s"] > 0.0).all()
    assert run.results["engine"].tolist() == ["toy==1.0"]


@pytest.mark.usefixtures("toy")
def test_zeros_at_the_end_of_a_version_do_not_matter() -> None:
    """2.0.0 is the release that announces 2.0."""
    assert announced(["toy==2.0.0"])["toy==2.0.0"].name == "toy==2.0.0"


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("engine", "reported"),
    [
        ("toy==0.9", "toy==0.9 cannot be installed: "),
        ("toy==3.0", "toy==3.0 announces version 2.9; request toy==2.9"),
        (f"toy=={BROKEN}", f"toy=={BROKEN}: toy cannot be imported: RuntimeError: spoilt"),
        ("toy==1.0:n", "toy==1.0 has no method 'n' (available: m"),
    ],
)
def test_unavailable_version_is_refused(
    engine: str, reported: str, command: Callable[..., tuple[int, str, str]]
) -> None:
    """The error is one line after the announcement of the environment, with status 2; nothing is written."""
    status, out, error = command("run", "intermediate-axis", "--engine", engine, "--out", "made")
    assert (status, out) == (2, "")
    *before, fault = (line for line in error.splitlines() if not line.startswith("  "))  # of uv
    assert reported in fault
    assert before in ([], [f"creating an environment for {engine.partition(':')[0].replace('==', ' ')} ..."])
    assert not list(Path().glob("made*"))


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("since", "until", "there"),
    [
        ("1", "2.0", ["1.0", "1.0.5", "1.1", BROKEN, "1.9", "1.10", "2.0"]),
        ("1.2", "1.9", [BROKEN, "1.9"]),
        ("2.0", None, ["2.0", "3.0"]),
        ("2.1rc1", None, ["3.0"]),
    ],
)
def test_releases_are_listed_oldest_first(since: str, until: str | None, there: list[str]) -> None:
    """Both ends are included, ends that are not listed bound the range, and pre-releases are left out."""
    assert list(releases("toy", since, until)) == there


@pytest.mark.usefixtures("toy")
def test_missing_releases_are_reported(expected_message: ExpectedMessage) -> None:
    """The error names the engine."""
    with expected_message.raises(InputError):
        releases("toy", "9.0", None)


ERRORS = {"1": 1e-3, "2": 1e-3, "3": 1e-3, "4": 1e-6, "5": 1e-6, "6": 1e-6, "7": 1e-6}


@pytest.fixture
def reported(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that receives the name of each release run; ERRORS replaces uv and the engine."""
    method = Method("m", "", 1, 1, "every stage", "", "")

    def run(_asked: object, name: str, *_: object) -> version_search._Release:
        release = name.removeprefix("toy==")
        case = {"scenario": "intermediate-axis", "engine": "toy", "method": "m", "dt_s": STEPS[-1]}
        tables = make_tables([{**case, "orientation_error_rad": ERRORS[release]}], scenarios={})
        return version_search._Release(Engine("toy", release, {"m": method}), {"m": method}, tables)

    monkeypatch.setattr(version_search, "releases", lambda *_: tuple(ERRORS))
    monkeypatch.setattr(version_search, "_run", run)
    return []


SEARCHED = ("toy", "1", None, "intermediate-axis", None, "orientation_error_rad", STEPS)


@pytest.mark.parametrize("every", [None, False, True])
def test_releases_are_bisected_unless_every_one_is_requested(every: bool | None, reported: list[str]) -> None:
    """Each release is run once, both ends first, and each finding is the value in its release."""
    requested = version_search.ReleaseSearch(*SEARCHED, **({} if every is None else {"every": every}))
    assert not requested.allow_code
    found = version_search.search(requested, Request(), reported.append)
    assert reported[:2] == ["toy==1", "toy==7"]
    assert len(reported) == len({*reported}) == (7 if every else 5)
    (track,) = found.tracks
    assert {release: finding.value for release, finding in track.findings.items()} == {
        name.removeprefix("toy=="): ERRORS[name.removeprefix("toy==")] for name in reported
    }
    assert track.changes == (("3", "4"),)
    assert (found.versions, found.failed, found.every) == (tuple(ERRORS), {}, bool(every))


def facts(name: str, control: Control = "dt", *, on_request: bool = False) -> Method:
    """Return the facts of a toy method."""
    tolerances = (1e-6, 1e-9) if control == "tolerance" else ()
    return Method(
        *(name, "", 1, 1, "every stage", "", ""),
        control=control,
        tolerances=tolerances,
        only_on_request=on_request,
    )


METHODS = [facts("m"), facts("n", "tolerance"), facts("exact", "none"), facts("slow", on_request=True)]


@pytest.fixture
def selected(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Selection, dict[str, Any]]]:
    """Return a list that receives each selection run; release 1 lacks "n", release 3 cannot be run."""
    runs: list[tuple[Selection, dict[str, Any]]] = []

    def announced(names: list[str]) -> dict[str, Engine | str]:
        (name,) = names
        release = name.removeprefix("toy==")
        if release == "3":
            return {name: f"{name} is spoilt"}
        methods = {one.name: one for one in METHODS if (release, one.name) != ("1", "n")}
        return {name: Engine(name, release, methods)}

    def run_selection(selection: Selection, options: Request, identity: Identity, **rest: Any) -> Tables:
        assert options == Request(jobs=1)
        assert isinstance(identity, Identity)
        runs.append((selection, rest))
        ((_, scenario),) = selection.scenarios
        cases = [
            {"scenario": "intermediate-axis", "engine": "toy", "method": method.name}
            | {"control": method.control, **vars(setting), "orientation_error_rad": 10.0**-place}
            for engine, method in selection.methods
            for place, setting in enumerate(selection.settings(scenario, engine, method))
        ]
        return make_tables(cases, scenarios={})

    monkeypatch.setattr(version_search, "announced", announced)
    monkeypatch.setattr(version_search, "run_selection", run_selection)
    monkeypatch.setattr(version_search, "releases", lambda *_: ("1", "2", "3"))
    return runs


SEARCH_FIELDS = ("engine", "since", "until", "scenario", "method", "measure", "dt_s")


def searched(**requested: Any) -> tuple[Found, list[str]]:
    """Return the result of a search in releases 1 to 3, and the names passed to the progress bar."""
    shown: list[str] = []

    @contextmanager
    def progress(name: str, cases: int) -> Iterator[Any]:
        shown.append(f"{name}: {cases}")
        yield name

    words = dict(zip(SEARCH_FIELDS, SEARCHED, strict=True)) | {"dt_s": None, **requested}
    request = version_search.ReleaseSearch(**words)
    return search(request, Request(jobs=1), lambda _: None, lambda name: partial(progress, name)), shown


def test_releases_are_run_with_all_methods_that_are_not_on_request(
    selected: list[tuple[Selection, dict[str, Any]]],
) -> None:
    """Releases are run at the scenario's steps without a journal; a missing method has no value."""
    found, shown = searched()
    assert found.failed == {"3": "toy==3 is spoilt"}
    assert [track.method for track in found.tracks] == ["m", "exact", "n"]
    assert [[method.name for _, method in one.methods] for one, _ in selected] == [
        ["m", "exact"],
        ["m", "n", "exact"],
    ]
    ((_, scenario),) = selected[0][0].scenarios
    for release, (selection, rest) in zip("12", selected, strict=True):
        assert [(spec, one.name) for spec, one in selection.scenarios] == [("intermediate-axis",) * 2]
        assert {engine.name for engine, _ in selection.methods} == {f"toy=={release}"}
        assert (selection.dt_s, selection.tolerances, selection.unavailable) == (None, None, {})
        assert rest == {"journal": None, "progress": f"toy=={release}"}
    assert shown == [
        f"toy=={release}: {one.cases_listed()}" for release, (one, _) in zip("12", selected, strict=True)
    ]
    values = {track.method: [one.value for one in track.findings.values()] for track in found.tracks}
    finest = 10.0 ** (1 - len(scenario.steps))
    assert values == {"m": [finest] * 2, "exact": [1.0] * 2, "n": ["no such method", 0.1]}
    assert [track.changes for track in found.tracks] == [(), (), (("1", "2"),)]


@pytest.mark.parametrize("method", ["slow", "m"])
def test_requested_method_is_run_alone(method: str, selected: list[tuple[Selection, dict[str, Any]]]) -> None:
    """A requested method, even one that runs only on request, is run alone at the requested steps."""
    found, _ = searched(method=method, dt_s=STEPS)
    assert [[one.name for _, one in selection.methods] for selection, _ in selected] == [[method]] * 2
    assert [selection.dt_s for selection, _ in selected] == [tuple(STEPS)] * 2
    assert [track.method for track in found.tracks] == [method]


def test_release_without_the_requested_method_is_not_run(
    selected: list[tuple[Selection, dict[str, Any]]],
) -> None:
    """That release has no value, and the change is the release that added the method."""
    found, shown = searched(method="n")
    assert shown == ["toy==2: 2"]
    assert len(selected) == 1
    (track,) = found.tracks
    assert track.changes == (("1", "2"),)


@pytest.mark.parametrize(
    "arguments",
    [
        {"method": "x"},
        {"scenario": "smoke"},
    ],
)
@pytest.mark.usefixtures("selected")
def test_search_for_nothing_is_refused(arguments: dict[str, Any], expected_message: ExpectedMessage) -> None:
    """The error lists the available names."""
    with expected_message.raises(InputError):
        searched(**arguments)


def test_search_without_a_sound_release_has_the_reason_of_each(
    selected: list[tuple[Selection, dict[str, Any]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error has one line per release."""
    monkeypatch.setattr(version_search, "announced", lambda names: {names[0]: f"{names[0]} is spoilt"})
    with pytest.raises(InputError) as refused:
        searched()
    assert str(refused.value).splitlines() == [f"toy=={release} is spoilt" for release in "123"]
    assert selected == []


@pytest.mark.parametrize("allowed", [False, True])
@pytest.mark.usefixtures("selected")
def test_search_runs_code_of_a_scenario_only_if_allowed(
    allowed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search passes on the permission to run code, as a run does."""
    requested: list[bool] = []
    checked = version_search.checked_scenarios

    def noted(*words: Any, allow_code: bool = False) -> Any:
        requested.append(allow_code)
        return checked(*words, allow_code=allow_code)

    monkeypatch.setattr(version_search, "checked_scenarios", noted)
    searched(allow_code=allowed)
    assert requested == [allowed]


@pytest.mark.nightly
@pytest.mark.usefixtures("toy")
def test_release_in_which_a_measure_changed_is_found(
    command: Callable[..., tuple[int, str, str]],
) -> None:
    """One command finds the release; a release that cannot be imported is skipped and reported."""
    status, out, error = command("versions", "toy", "--since", "1.0", "--until", "2.0", "--dt", DT)
    assert status == 0, error
    lines = out.splitlines()
    found = re.fullmatch(
        r"order.orientation_error_rad of toy:m: (\S+) up to 1\.9, (\S+) from 1\.10", lines[0]
    )
    assert found is not None, lines[0]
    assert [float(order) for order in found.groups()] == pytest.approx([1.0, 4.0], abs=0.05)
    head = "order.orientation_error_rad on intermediate-axis; 7 releases from 1.0 to 2.0"
    assert any(line.startswith(head) for line in lines)
    assert ["1.10", found.group(2)] in [line.split() for line in lines]
    assert any(
        line.startswith(f"not run: {BROKEN}: toy=={BROKEN}: toy cannot be imported: ") for line in lines
    )


@pytest.mark.nightly
@pytest.mark.usefixtures("toy")
def test_every_release_is_run_on_request(command: Callable[..., tuple[int, str, str]]) -> None:
    """With --every a change that was undone within the range is found, and all its releases are named."""
    words = ("versions", "toy", "--since", "1.0", "--until", "1.9", "--method", "m", "--dt", "2e-2,1e-2")
    measure = ("--measure", "orientation_error_rad")
    status, out, error = command(*words, *measure)
    assert status == 0, error
    assert out.splitlines()[0].endswith("a change that was undone between them would be missed")
    status, out, error = command(*words, *measure, "--every")
    assert status == 0, error
    changed, reported, about, *_ = out.splitlines()
    assert about.endswith("; 5 releases from 1.0 to 1.9, 4 of them run")
    assert re.fullmatch(r"toy:m: (\S+) up to 1.0, \S+ from 1.0.5 to 1.0.5, \1 from 1.1", reported), reported
    assert changed == "orientation_error_rad changed in 1.0.5 (m), 1.1 (m)"


@pytest.mark.nightly
@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("measure", "reported"),
    [
        ("verdict", "converges in 1.1, as in 1.0"),
        pytest.param("energy_drift", " in 1.1, as in 1.0", marks=pytest.mark.nightly),
    ],
)
def test_equal_ends_are_reported(
    measure: str, reported: str, command: Callable[..., tuple[int, str, str]]
) -> None:
    """Both ends are equal; the output warns that a change undone between them would be missed."""
    words = ("versions", "toy", "--since", "1.0", "--until", "1.1", "--measure", measure, "--dt", DT)
    status, out, error = command(*words)
    assert status == 0, error
    assert reported in out.splitlines()[0]
    assert out.splitlines()[0].endswith("a change that was undone between them would be missed")


@pytest.mark.slow
@pytest.mark.nightly(after=3)
@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (("--since", "1.0", "--measure", "beauty"), "--measure beauty: unknown measure 'beauty'"),
        (("--since", "1.0", "--measure", "cpu_s"), "cannot search by speed"),
        (("--since", "1.0", "--measure", "steps"), "runs are not compared by it"),
        (("--since", "1.0", "--until", "1.1", "--method", "n"), "toy has no such method (available: m"),
        (("--since", "1.x"), "--since 1.x: not a version"),
        (("--since", "1.0", "--scenario", "smoke"), "--scenario smoke: names 3 scenarios"),
        (("--since", "1.0", "--scenario", "nowhere"), "nowhere"),
        (("--since", "1.0", "--dt", "0.03"), "0.03"),
        (("--since", BROKEN, "--until", BROKEN), "spoilt"),
    ],
)
def test_wrong_arguments_are_refused(
    words: tuple[str, ...], reported: str, command: Callable[..., tuple[int, str, str]]
) -> None:
    """The status is 2, and the error states the valid form."""
    status, out, error = command("versions", "toy", *words)
    assert (status, out) == (2, "")
    assert reported in error


@pytest.mark.nightly
@pytest.mark.parametrize(("scenario", "order"), [("intermediate-axis", "4.01"), ("free-chain", "3.99")])
def test_mujocos_rk4_is_of_order_4_from_4_0_0(
    command: Callable[..., tuple[int, str, str]], scenario: str, order: str
) -> None:
    """In the real releases, if an index can be reached, the order is 2 in 3.17.0 and 4 in 4.0.0."""
    try:
        between = releases("mujoco", "3.16.0", "4.0.0")
    except (InputError, UnavailableError) as error:
        pytest.skip(f"no registry: {error}")
    assert between == ("3.16.0", "3.17.0", "4.0.0")
    words = ("versions", "mujoco", "--since", "3.16.0", "--until", "4.0.0", "--method", "rk4")
    status, out, error = command(*words, "--scenario", scenario)
    assert status == 0, error
    assert (
        out.splitlines()[0]
        == f"order.orientation_error_rad of mujoco:rk4: 2.00 up to 3.17.0, {order} from 4.0.0"
    )


@pytest.mark.nightly
def test_mujocos_4_0_0_improved_and_3_17_0_is_worse(
    command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    """Two nightly runs of the real releases are compared by both commands, and only the downgrade fails."""
    try:
        releases("mujoco", "3.17.0", "4.0.0")
    except (InputError, UnavailableError) as error:
        pytest.skip(f"no registry: {error}")
    words = ("nightly", "intermediate-axis", "--history", "kept", "--no-speed", "--engine")
    status, out, error = command(*words, "mujoco==3.17.0")
    assert status == 3, out + error
    status, out, error = command(*words, "mujoco==4.0.0", "--markdown", "told.md")
    assert status == 0, out + error
    first, headline, *_ = out.splitlines()
    assert first == "No regression; mujoco:rk4 improved."
    improved = r"mujoco:rk4 improved: order 2 -> 4 in orientation, error at dt 0.001 s x 5.\de-7, "
    renamed = "one-step map RK4 on the rotation group, stages averaged -> RK4 Munthe-Kaas "
    assert re.match(f"{improved}{renamed}in intermediate-axis .since version 4.0.0, 3.17.0 before", headline)
    search = (
        "bodycheck versions mujoco --since 3.17.0 --until 4.0.0 --scenario intermediate-axis --method rk4"
    )
    found = f"To find the release: {search} --measure orientation_error_rad --dt 0.001"
    assert found in out.splitlines()
    assert found.replace("release: ", "release: `") + "`" in Path("told.md").read_text()
    old, new = (f"kept/{night.name}" for night in sorted((tmp_path / "kept").glob("2*")))
    status, out, error = command("compare", old, new, "--fail-on", "worse")
    assert (status, out.splitlines()[0]) == (0, headline), error
    status, out, error = command("compare", new, old, "--fail-on", "worse")
    assert status == 1, error
    assert out.startswith("mujoco:rk4: order 4 -> 2 in orientation, error at dt 0.001 s x 1.")
    status, out, error = command("compare", new, new, "--fail-on", "moved")
    assert (status, out[:16]) == (0, "Nothing changed "), error
