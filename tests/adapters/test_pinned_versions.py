"""Pinned engine versions: the requests, the calls of uv, and the facts that depend on the version."""

from __future__ import annotations

import fcntl
import json
import os
import sys
import threading
from importlib.metadata import version
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace

import pytest

from bodycheck._util.errors import UnavailableError
from bodycheck.adapters.engine_names import Pin, admit, engine_fault, pin_of
from bodycheck.adapters.mujoco.mj_model import methods_of
from bodycheck.adapters.registry import registered, stated_by
from bodycheck.adapters.versions import environments, uv
from bodycheck.adapters.versions.uv import UvError, pip_settings
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck


def test_pin_is_written_as_for_pip() -> None:
    """NAME==VERSION is a pin and is printed unchanged; a name alone is not a pin."""
    assert pin_of("mujoco==3.6.0") == Pin("mujoco", "3.6.0")
    assert Pin("mujoco", "3.6.0").name == "mujoco==3.6.0"
    assert pin_of("mujoco") is None
    assert pin_of("cmd:./worker --release==2") is None


def test_program_is_valid_where_it_exists() -> None:
    """An existing program has no fault; for any other the fault names what is missing."""
    with registered():
        admit(["cmd:true", "cmd:./no-such-worker"], allow_code=True)
        assert engine_fault("cmd:true") is None
        fault = engine_fault("cmd:./no-such-worker")
    assert fault == "cmd:./no-such-worker: no such program: ./no-such-worker"


@pytest.mark.parametrize(
    "name",
    [
        *(
            "mujoco:rk4",
            "mujoco==3.*",
            "mujoco==",
            "mujoco===3.6.0",
            "mujoco==3.6.0 --index-url=http://elsewhere",
            "mujoco==3.x",
        ),
        *("havok==1.0", "mujoco>=3.6", "mujoco=3.6.0", "mujoco=", "havok=1.0", "reference==0.1"),
    ],
)
def test_invalid_pin_is_refused(name: str, expected_message: ExpectedMessage) -> None:
    """A pattern, a range, an unknown engine and an engine without a package are refused in one line."""
    fault = engine_fault(name)
    assert fault is not None
    expected_message(fault)


@pytest.mark.parametrize(
    "name", ["mujoco", "mujoco==3.6.0", "dart==6.19.5", "pybullet==3.2.7", "mujoco==4.0.0rc1"]
)
def test_valid_names_are_accepted(name: str) -> None:
    """An engine is accepted as installed or in one release."""
    assert engine_fault(name) is None


@pytest.mark.parametrize(
    ("release", "rk4", "implicit", "implicitfast"),
    [
        ("3.6.0", 2, 1, 1),
        ("3.7.0", 2, 2, 2),
        ("3.8.0", 2, 2, 2),
        ("3.8.1", 2, 1, 2),
        ("3.10.0", 2, 1, 2),
        ("3.11.0", 2, 1, 1),
        ("3.17.0", 2, 1, 1),
        ("4.0.0", 4, 1, 1),
        ("4.1.0rc1", 4, 1, 1),
    ],
)
def test_orders_of_mujoco_depend_on_the_version(
    release: str, rk4: int, implicit: int, implicitfast: int
) -> None:
    """The orders are those measured in each release, and versions are compared as numbers."""
    orders = {name: method.order for name, method in methods_of(release).items()}
    assert orders == {
        "euler": 1,
        "rk4": rk4,
        "implicit": implicit,
        "implicitfast": implicitfast,
        "discrete": 1,
    }


LISTED = """\
:env:.find-links='/opt/wheels /opt/more'
global.cert='/etc/ssl/own.pem'
global.extra-index-url='https://a.example/simple https://b.example/simple'
global.find-links='/old'
global.index-url='https://c.example/simple'
global.timeout='60'
install.index-url='https://d.example/simple'
"""


def test_uv_gets_the_settings_of_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    """Indexes, links and certificates follow pip's order of precedence; no other setting is passed on."""
    for name in (*uv._UV_INDEXES, *uv._PIP_TO_UV.values()):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(uv, "_pip_config", lambda: LISTED)
    assert pip_settings() == {
        "UV_DEFAULT_INDEX": "https://d.example/simple",
        "UV_INDEX": "https://a.example/simple https://b.example/simple",
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_FIND_LINKS": "/opt/wheels,/opt/more",
        "SSL_CERT_FILE": "/etc/ssl/own.pem",
    }


@pytest.mark.parametrize("name", uv._UV_INDEXES)
def test_settings_of_uv_take_precedence(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """If uv has its own index, pip's settings are ignored."""
    monkeypatch.setattr(uv, "_pip_config", lambda: LISTED)
    monkeypatch.setenv(name, "https://e.example/simple")
    assert pip_settings() == {}


def test_missing_uv_is_reported_with_the_command(
    monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """The error is one line with the command that installs uv."""
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(uv, "import_module", _no_module)
    with expected_message.raises(UnavailableError):
        uv.uv("--version")


def _no_module(name: str) -> None:
    raise ModuleNotFoundError(name)


class FakeUv:
    """Creates environments without an index; it refuses one word of a command or of the constraints.

    wheels_for: the only Python with wheels of the engine; "" for any.
    """

    def __init__(self) -> None:
        self.refuses, self.wheels_for, self._venv_for = "nothing", "", ""
        self.commands: list[tuple[str, ...]] = []
        self.constraints: list[str] = []

    def __call__(self, *words: str, stdin: str = "", downloads: bool = False, progress: bool = False) -> str:
        """Do what uv does; the current Python is never downloaded."""
        del progress
        assert not downloads or self.wheels_for
        self.commands.append(words)
        if words[0] == "venv":
            self._venv_for = words[words.index("--python") + 1]
        installs = {
            "pip install": self._venv_for,
            "pip compile": words[words.index("--python-version") + 1] if "--python-version" in words else "",
        }
        if self.wheels_for and installs.get(" ".join(words[:2]), self.wheels_for) != self.wheels_for:
            raise UvError("no wheels", refused=True)
        if "-c" in words:
            self.constraints.append(Path(words[words.index("-c") + 1]).read_text())
        if words[0] == "venv":
            (Path(words[-1]) / "bin").mkdir(parents=True)
            (Path(words[-1]) / "bin" / "python").touch()
        if self.refuses in (*words, *stdin.splitlines()) or any(
            self.refuses in text for text in self.constraints[-1:]
        ):
            raise UvError("no such version", refused=True)
        return ""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FakeUv:
    """Replace uv by a fake, and put the environments into a folder of the test."""
    made = FakeUv()
    monkeypatch.setattr(environments, "uv", made)
    monkeypatch.setattr(environments, "cache_dir", lambda: tmp_path)
    return made


PIN = Pin("mujoco", "3.6.0")


def test_environment_has_a_python_for_which_there_are_wheels(fake: FakeUv) -> None:
    """If the release has no wheels for the current Python, its environment has another one."""
    fake.wheels_for = "3.14"
    environments.python_of(PIN)
    made = [words[words.index("--python") + 1] for words in fake.commands if words[0] == "venv"]
    assert made == [sys.executable, "3.14"]
    fake.wheels_for = "3.2"
    with pytest.raises(UnavailableError):
        environments.python_of(Pin("mujoco", "3.7.0"))


def test_environment_is_created_once(fake: FakeUv) -> None:
    """A second request uses the existing environment, and another version has its own."""
    python = environments.python_of(PIN)
    made = len(fake.commands)
    assert environments.python_of(PIN) == python
    assert len(fake.commands) == made
    assert environments.python_of(Pin("mujoco", "3.7.0")) != python


@pytest.mark.parametrize(
    ("requires", "pin"),
    [(("numpy", "numba>=0.50"), None), (("numpy", "no-such-package==1"), Pin("any", None))],
)
def test_engine_whose_packages_are_installed_needs_no_environment(
    requires: tuple[str, ...], pin: Pin | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Installed packages that meet the requirements suffice, because pip has checked their versions."""
    monkeypatch.setattr(environments, "stated_by", lambda _: SimpleNamespace(requires=requires))
    assert environments.needed_environment("any") == pin


def test_environment_has_the_python_that_the_adapter_requires(
    fake: FakeUv, monkeypatch: pytest.MonkeyPatch
) -> None:
    """uv may download the required Python, and each Python has its own environment."""
    requested: list[tuple[str, bool]] = []

    def uv_of_any_python(*words: str, downloads: bool = False, progress: bool = False) -> str:
        del progress
        if words[0] == "venv":
            requested.append((words[2], downloads))
        return fake(*words)

    monkeypatch.setattr(environments, "uv", uv_of_any_python)
    here = environments.python_of(PIN)
    stated = SimpleNamespace(requires_python="==3.12.*", requires=("mujoco",))
    monkeypatch.setattr(environments, "stated_by", lambda _: stated)
    assert environments.python_of(PIN) != here
    assert requested == [(sys.executable, False), ("==3.12.*", True)]


def test_other_requirements_of_an_adapter_make_another_environment(
    fake: FakeUv, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other requirements need another environment; the pin replaces that of the engine's own package."""
    places = []
    for requires in (("mujoco>=3", "jax"), ("mujoco>=3", "jax>=0.9"), ("mujoco>=3.1", "jax>=0.9")):
        stated = SimpleNamespace(requires=requires)
        monkeypatch.setattr(environments, "stated_by", lambda _, stated=stated: stated)
        places.append(environments.python_of(PIN))
    assert [place == places[-1] for place in places] == [False, True, True]
    assert [command[-5:-3] for command in fake.commands if command[0] == "pip"] == [
        ("mujoco==3.6.0", "jax"),
        ("mujoco==3.6.0", "jax>=0.9"),
    ]


def test_index_that_cannot_be_reached_is_no_reason_for_older_libraries(
    fake: FakeUv, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """If the index cannot be reached, the environment is not created again without constraints."""

    def unreachable(*words: str, downloads: bool = False, progress: bool = False) -> str:
        fake(*words, downloads=downloads, progress=progress)
        if words[0] == "pip":
            raise UvError("no route to the index", refused=False)
        return ""

    monkeypatch.setattr(environments, "uv", unreachable)
    with expected_message.raises(UnavailableError):
        environments.python_of(PIN)
    assert len(fake.commands) == 2


def test_uv_installs_wheels_of_the_release_only(fake: FakeUv) -> None:
    """uv gets this Python, no builds, the worker's imports, and no bodycheck from an index."""
    python = environments.python_of(PIN)
    venv, install = fake.commands
    assert venv[:3] == ("venv", "--python", sys.executable)
    assert install[:3] == ("pip", "install", "--python")
    assert Path(install[3]).parts[-2:] == ("bin", "python")
    assert "--no-build" in install
    assert install[-4:] == ("mujoco==3.6.0", "numpy", "numba", "pydantic")
    files = [Path(install[install.index(option) + 1]).name for option in ("-c", "--override")]
    assert files == ["constraints.txt", "overrides.txt"]
    assert (python.parents[1] / files[1]).read_text() == "bodycheck ; python_version < '0'\n"


def test_environment_of_another_python_or_library_is_another_one(
    fake: FakeUv, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An update of either needs a new environment, because compiled packages may not fit the old one."""
    places = [environments.python_of(PIN)]
    for name in ("version", "base_prefix"):
        facts = {"version": sys.version, "base_prefix": sys.base_prefix, name: "another"}
        others = SimpleNamespace(**facts, executable=sys.executable, stderr=sys.stderr)
        monkeypatch.setattr(environments, "sys", others)
        places.append(environments.python_of(PIN))
    for changed in ("numpy", "numba", "pydantic"):
        monkeypatch.setattr(
            environments, "version", lambda name, of=changed: "99" if name == of else version(name)
        )
        places.append(environments.python_of(PIN))
        assert f"{changed}==99" in fake.constraints[-1].splitlines()
    assert len({*places}) == len(places) == 6
    assert all(place.parents[1].name.startswith("mujoco-3.6.0-") for place in places)


@pytest.mark.usefixtures("fake")
def test_cache_that_cannot_be_written_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """One line names the engine, the folder and the reason."""
    (tmp_path / "file").touch()
    monkeypatch.setattr(environments, "cache_dir", lambda: tmp_path / "file")
    with expected_message.raises(UnavailableError):
        environments.python_of(PIN)


@pytest.mark.parametrize(
    ("origin", "released", "local"),
    [
        (None, ["made-up-plugin==0.1"], []),
        ({"url": "https://a.example/x.whl"}, ["made-up-plugin==0.1"], []),
        ({"url": "file:///a%20folder/plugin"}, ["toy-engine>=2", "scipy"], ["/a folder/plugin"]),
    ],
)
def test_plug_in_is_installed_with_its_engine(
    origin: dict[str, str] | None,
    released: list[str],
    local: list[str],
    fake: FakeUv,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A plug-in comes in its release, or from its folder without extras and without dependency resolution."""
    facts = tmp_path / "site" / "made_up_plugin-0.1.dist-info"
    facts.mkdir(parents=True)
    needs = ("toy-engine>=2", "scipy", "pytest; extra == 'tests'")
    lines = ("Metadata-Version: 2.1", "Name: made-up-plugin", "Version: 0.1")
    metadata = (*lines, *(f"Requires-Dist: {need}" for need in needs))
    (facts / "METADATA").write_text("\n".join(metadata) + "\n")
    if origin is not None:
        (facts / "direct_url.json").write_text(json.dumps(origin))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.setattr(environments, "plug_in_of", lambda _: "made-up-plugin")
    python = environments.python_of(Pin("mujoco", "3.6.0"))
    _, install, *more = fake.commands
    overrides = install.index("--override") + 2
    assert list(install[overrides:]) == ["mujoco==3.6.0", *released, "numpy", "numba", "pydantic"]
    prefix = ("pip", "install", "--python", str(python).replace("/bin/", ".part/bin/"))
    assert [tuple(command) for command in more] == [(*prefix, "--no-deps", place) for place in local]


@pytest.mark.usefixtures("fake")
def test_cache_folder_is_created(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cache folder is created with its parents."""
    monkeypatch.setattr(environments, "cache_dir", lambda: tmp_path / "no" / "such")
    assert environments.python_of(PIN).exists()


@pytest.mark.usefixtures("fake")
def test_environment_is_announced_before_it_is_created(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standard error has a line before the creation and one after; none if the environment exists."""
    reported: list[str] = []
    monkeypatch.setattr(environments, "_make", lambda _pin, place: _make_now(place, reported, capsys))
    environments.python_of(PIN)
    made = capsys.readouterr().err
    assert made.startswith("  made in ")
    assert str(environments._place(PIN)) in made
    environments.python_of(PIN)
    assert reported == ["creating an environment for mujoco 3.6.0 ...\n"]
    assert capsys.readouterr().err == ""


def _make_now(place: Path, reported: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Create an environment and store the announcements before it."""
    reported.append(capsys.readouterr().err)
    (place / "bin").mkdir(parents=True)
    (place / "bin" / "python").touch()


def test_concurrent_requests_create_one_environment(fake: FakeUv) -> None:
    """The second request waits for the first and uses its environment."""
    threads = [threading.Thread(target=environments.python_of, args=(PIN,)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(words[0] == "venv" for words in fake.commands) == 1


def test_incomplete_environment_is_never_used(
    fake: FakeUv, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """An environment whose packages failed is removed, and an interrupted one is replaced."""
    fake.refuses = "mujoco==3.6.0"
    with expected_message.raises(UnavailableError):
        environments.python_of(PIN)
    assert [path.name for path in (tmp_path / "environments").iterdir() if path.is_dir()] == []
    fake.refuses = "nothing"
    place = environments.python_of(PIN).parents[1]
    place.rename(place.with_name(f"{place.name}.part"))
    assert environments.python_of(PIN).exists()
    assert [path for path in (tmp_path / "environments").iterdir() if path.is_dir()] == [place]


def test_old_engine_gets_older_libraries(fake: FakeUv) -> None:
    """An engine that is incompatible with the current numpy and numba gets compatible ones."""
    fake.refuses = "numpy=="
    assert environments.python_of(PIN).exists()
    as_here, as_it_takes = fake.constraints
    assert f"numpy=={version('numpy')}" in as_here
    assert f"numba=={version('numba')}" in as_here
    assert as_it_takes == ""


SOURCES = (
    "UV_DEFAULT_INDEX",
    "UV_INDEX_URL",
    "UV_INDEX",
    "UV_EXTRA_INDEX_URL",
    "UV_FIND_LINKS",
    "UV_NO_INDEX",
    "UV_INDEX_STRATEGY",
    "UV_CONSTRAINT",
    "UV_OVERRIDE",
)


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("name", SOURCES)
def test_another_index_makes_another_environment(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same version from another index may differ, so each index has its own environment."""
    monkeypatch.setattr(uv, "_pip_config", lambda: "")
    monkeypatch.delenv(name, raising=False)
    places = [environments.python_of(PIN)]
    for value in ("https://one.example/simple", "https://two.example/simple"):
        monkeypatch.setenv(name, value)
        places.append(environments.python_of(PIN))
        assert environments.python_of(PIN) == places[-1]
    assert len({*places}) == 3


@pytest.fixture
def users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Return the path of the user's uv configuration, and let the system have none."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.delenv("UV_CONFIG_FILE", raising=False)
    monkeypatch.setattr(uv, "_SYSTEM_FILES", (tmp_path / "system.toml",))
    monkeypatch.setattr(uv, "_pip_config", lambda: "")
    (tmp_path / "config/uv").mkdir(parents=True)
    return tmp_path / "config/uv/uv.toml"


def test_user_configuration_precedes_the_systems(
    users: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file named by a variable precedes both, and without any file uv does not search for one."""
    assert uv._users_configuration() == {"UV_NO_CONFIG": "1"}
    for file in (tmp_path / "system.toml", users, tmp_path / "named.toml"):
        file.write_text("")
        if file.name == "named.toml":
            monkeypatch.setenv("UV_CONFIG_FILE", str(file))
        assert uv._users_configuration() == {"UV_CONFIG_FILE": str(file)}


def test_user_without_a_home_has_no_configuration(users: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The configuration of the system still applies."""

    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setattr(uv.Path, "home", no_home)
    assert uv._users_configuration() == {"UV_NO_CONFIG": "1"}
    system = users.parents[2] / "system.toml"
    system.touch()
    assert uv._users_configuration() == {"UV_CONFIG_FILE": str(system)}


@pytest.mark.usefixtures("fake")
def test_another_user_configuration_makes_another_environment(users: Path) -> None:
    """The changed configuration may name another index, so it has its own environment."""
    places = [environments.python_of(PIN)]
    for text in ("no-index = true\n", "no-index = false\n"):
        users.write_text(text)
        places.append(environments.python_of(PIN))
    assert len({*places}) == 3


@pytest.mark.usefixtures("fake")
def test_environments_are_listed_and_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each environment, even an incomplete one, has engine, version, size and source without the password."""
    monkeypatch.setattr(uv, "_pip_config", lambda: "")
    monkeypatch.setenv("UV_INDEX_URL", "https://me:secret@one.example/simple")
    assert environments.environments() == []
    python = environments.python_of(PIN)
    python.write_text("12345")
    (tmp_path / "environments/mujoco-9-x.part").mkdir()
    half, whole = sorted(environments.environments(), key=lambda found: bool(found.packages_from))
    assert (half.name, half.packages_from, half.size) == ("mujoco-9-x.part", (), 0)
    assert whole.name == "mujoco==3.6.0"
    assert whole.folder == python.parents[1]
    assert "UV_INDEX_URL=https://one.example/simple" in whole.packages_from
    assert "secret" not in (whole.folder / "bodycheck.json").read_text()
    assert whole.size == sum(path.stat().st_size for path in whole.folder.rglob("*") if path.is_file())
    environments.remove(whole)
    environments.remove(half)
    assert environments.environments() == []


@pytest.mark.usefixtures("fake")
def test_removal_waits_for_the_maker(monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment that is listed under construction is removed once it is complete."""
    listed: list[environments.Environment] = []

    def make(_pin: Pin, place: Path) -> None:
        unfinished = place.with_name(f"{place.name}.part")
        unfinished.mkdir()
        listed.extend(environments.environments())
        with monkeypatch.context() as patch:
            patch.setattr(environments.fcntl, "LOCK_EX", fcntl.LOCK_EX | fcntl.LOCK_NB)
            with pytest.raises(BlockingIOError):
                environments.remove(listed[0])
        unfinished.rename(place)

    monkeypatch.setattr(environments, "_make", make)
    environments.python_of(PIN)
    environments.remove(listed[0])
    assert environments.environments() == []


@pytest.mark.usefixtures("fake")
def test_removal_keeps_the_lock() -> None:
    """A process that waits for the lock and a later one lock the same file."""
    folder = environments.python_of(PIN).parents[1]
    (lock,) = folder.parent.glob("*.lock")
    with lock.open() as waiting:
        environments.remove(*environments.environments())
        environments.python_of(PIN)
        assert os.fstat(waiting.fileno()).st_ino == lock.stat().st_ino


@pytest.mark.usefixtures("fake")
def test_environment_commands_list_and_remove(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """`list` prints the folder and a line per environment; `remove` needs a name or --all, and no more."""
    places = [environments.python_of(pin).parents[1] for pin in (PIN, Pin("mujoco", "3.7.0"))]
    lead, _, *lines = run_bodycheck(tmp_path, "environments", "list").stdout.splitlines()
    assert lead == f"2 environments, together 0 MB, where shared files count once, in {places[0].parent}"
    assert lines[:2] == [f"mujoco==3.{6 + k}.0  0 MB  {place.name}" for k, place in enumerate(places)]
    for words in ((), ("mujoco==3.6.0", "--all"), ("mujoco==3.8.0",)):
        refused = run_bodycheck(tmp_path, "environments", "remove", *words)
        assert refused.returncode == 2
        expected_message(refused.stderr.strip())
    assert all(place.exists() for place in places)
    removed = run_bodycheck(tmp_path, "environments", "remove", "mujoco==3.6.0")
    assert removed.stdout.split() == [str(places[0])]
    assert [place.exists() for place in places] == [False, True]
    run_bodycheck(tmp_path, "environments", "remove", "--all")
    expected_message(run_bodycheck(tmp_path, "environments", "list").stdout.strip())
    assert run_bodycheck(tmp_path, "environments", "list", "--json").stdout == "[]\n"


@pytest.mark.parametrize(("status", "printed"), [(0, LISTED), (1, "")])
def test_folder_named_pip_is_not_imported(status: int, printed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder `pip` in the working directory is ignored, and without pip there are no settings."""
    requested: list[list[str]] = []

    def run(words: list[str], **_: object) -> CompletedProcess[str]:
        requested.append(words)
        return CompletedProcess(words, status, LISTED, "")

    monkeypatch.setattr(uv.subprocess, "run", run)
    assert uv._pip_config.__wrapped__() == printed
    assert requested == [[sys.executable, "-P", "-m", "pip", "config", "list"]]


@pytest.mark.parametrize(("status", "printed"), [(0, "global.cert='/own.pem'\n"), (1, "")])
def test_settings_are_those_that_pip_prints(
    status: int,
    printed: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """pip's output is captured as text, and a pip that fails gives no settings."""
    (tmp_path / "pip.py").write_text(f"import sys\nprint(\"global.cert='/own.pem'\")\nsys.exit({status})\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert uv._pip_config.__wrapped__() == printed
    assert capfd.readouterr().out == ""


def test_output_of_uv_is_one_line_of_limited_length() -> None:
    """The tree characters are removed, and a text above 400 characters is truncated."""
    assert uv.in_one_line("error: no such package\n  ╰─▶ cause: it was withdrawn\n") == (
        "no such package it was withdrawn"
    )
    assert uv.in_one_line("x" * 400) == "x" * 400
    assert uv.in_one_line("x" * 401) == "x" * 400 + "..."


class FakeNpm:
    """Creates folders of JavaScript packages without an index, or fails."""

    def __init__(self, status: int = 0) -> None:
        self.status = status
        self.commands: list[list[str]] = []

    def __call__(
        self, command: list[str], *, capture_output: bool, text: bool, check: bool, cwd: Path
    ) -> CompletedProcess[str]:
        """Do what npm does: the caller reads its message as text and checks its status."""
        assert (capture_output, text, check) == (True, True, False)
        assert json.loads((cwd / "package.json").read_text()) == {"private": True}
        self.commands.append(command)
        (cwd / "node_modules").mkdir()
        return CompletedProcess(command, self.status, "", "404 not\nfound")


@pytest.fixture
def npm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FakeNpm:
    """Replace npm by a fake, and put the environments into a folder of the test."""
    made = FakeNpm()
    monkeypatch.setattr(uv, "_pip_config", lambda: "")
    monkeypatch.setattr(environments.shutil, "which", lambda name: f"/bin/{name}")
    monkeypatch.setattr(environments.subprocess, "run", made)
    monkeypatch.setattr(environments, "cache_dir", lambda: tmp_path)
    return made


CANNON = Pin("cannon-es", "0.20.0")


def test_javascript_engine_is_a_program_of_node(npm: FakeNpm) -> None:
    """The worker finds its packages by a variable; the folder is created once and listed like the others."""
    assert not environments.is_made(CANNON)
    program = environments.program_in(CANNON)
    assert program is not None
    assert environments.is_made(CANNON)
    (found,) = environments.environments()
    assert found.name == "cannon-es==0.20.0"
    worker = stated_by("cannon-es").worker
    assert worker.is_file()
    assert program.command == ["node", str(worker)]
    assert program.environment == {"BODYCHECK_NODE_PACKAGES": str(found.folder)}
    assert environments.program_in(CANNON) == program
    (command,) = npm.commands
    assert command[:2] == ["npm", "install"]
    assert command[-1] == "cannon-es@0.20.0"
    assert Path(command[command.index("--prefix") + 1]).name == f"{found.folder.name}.part"
    assert {"--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"} <= set(command)


def test_environment_of_npm_is_independent_of_python(npm: FakeNpm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Updates of Python and its libraries, and other indexes of uv, install no JavaScript package again."""
    environments.program_in(CANNON)
    monkeypatch.setattr(environments, "version", lambda _: "99")
    monkeypatch.setattr(environments.sys, "version", "another")
    monkeypatch.setattr(environments, "index_settings", lambda: ["UV_DEFAULT_INDEX=https://one.example"])
    environments.program_in(CANNON)
    assert len(npm.commands) == 1
    environments.program_in(Pin("cannon-es", "0.19.0"))
    assert len(npm.commands) == 2


def test_engine_of_python_packages_is_no_program(fake: FakeUv) -> None:
    """An engine with Python packages has no program, and finding this out creates nothing."""
    assert environments.program_in(PIN) is None
    assert fake.commands == []


def test_failed_npm_leaves_no_environment(
    npm: FakeNpm, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The reason is the output of npm in one line."""
    npm.status = 1
    with expected_message.raises(UnavailableError):
        environments.program_in(CANNON)
    assert [path for path in (tmp_path / "environments").iterdir() if path.is_dir()] == []


def test_javascript_engine_always_needs_an_environment() -> None:
    """A JavaScript engine never uses Python packages, even if one of the same name is installed."""
    assert environments.needed_environment("cannon-es") == Pin("cannon-es", None)
    assert environments.needed_environment("cannon-es==0.20.0") == CANNON
    assert environments.needed_environment("mujoco") is None


@pytest.mark.usefixtures("npm")
@pytest.mark.parametrize("missing", ["node", "npm"])
def test_javascript_engine_needs_node_and_npm(
    missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """The error names the missing program, and nothing is written."""
    monkeypatch.setattr(environments.shutil, "which", lambda name: None if name == missing else name)
    with expected_message.raises(UnavailableError):
        environments.program_in(CANNON)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("npm")
def test_existing_javascript_environment_needs_node_only(
    monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """Without npm it is used; without Node.js the message is that of one that does not exist."""
    environments.program_in(CANNON)
    monkeypatch.setattr(environments.shutil, "which", lambda name: None if name == "npm" else name)
    assert environments.program_in(CANNON) is not None
    monkeypatch.setattr(environments.shutil, "which", lambda _: None)
    with expected_message.raises(UnavailableError):
        environments.program_in(CANNON)
