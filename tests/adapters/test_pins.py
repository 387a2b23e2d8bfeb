"""Engines in versions of their own: what is asked for, what uv is told, what is known of each version."""

from __future__ import annotations

import sys
import threading
from importlib.metadata import version
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from front_door import bodycheck_in

from bodycheck._util.errors import UnavailableError
from bodycheck.adapters.mujoco.mj_model import methods_of
from bodycheck.adapters.versions import environments, uv
from bodycheck.adapters.versions.pins import Pin, engine_fault, pin_of
from bodycheck.adapters.versions.uv import UvError, pip_settings


def test_a_pin_is_written_as_pip_writes_it() -> None:
    """NAME==VERSION is that, and reads back; a name alone is none."""
    assert pin_of("mujoco==3.6.0") == Pin("mujoco", "3.6.0")
    assert Pin("mujoco", "3.6.0").name == "mujoco==3.6.0"
    assert pin_of("mujoco") is None


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("mujoco==3.*", "'3.*' is not a version"),
        ("mujoco==", "'' is not a version"),
        ("mujoco===3.6.0", "'=3.6.0' is not a version"),
        ("mujoco==3.6.0 --index-url=http://elsewhere", "is not a version"),
        ("mujoco==3.x", "'3.x' is not a version"),
        ("havok==1.0", "unknown engine 'havok'"),
        ("mujoco>=3.6", "unknown engine 'mujoco>=3.6'"),
        ("mujoco=3.6.0", "expected two signs, like mujoco==3.6.0"),
        ("mujoco=", "expected two signs, like mujoco==4.0.0"),
        ("havok=1.0", "unknown engine 'havok=1.0'"),
        ("reference==0.1", "part of bodycheck"),
    ],
)
def test_what_is_no_version_of_an_engine_is_refused(name: str, told: str) -> None:
    """A pattern, a range, an unknown engine, one that no package brings: said in one line."""
    fault = engine_fault(name)
    assert fault is not None
    assert told in fault
    assert "\n" not in fault


@pytest.mark.parametrize(
    "name", ["mujoco", "mujoco==3.6.0", "dart==6.19.5", "pybullet==3.2.7", "mujoco==4.0.0rc1"]
)
def test_good_names_are_accepted(name: str) -> None:
    """An engine as it is installed, or in one release."""
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
def test_orders_of_mujoco_are_those_of_the_version(
    release: str, rk4: int, implicit: int, implicitfast: int
) -> None:
    """As measured of the releases themselves; versions are compared as numbers, not as texts."""
    orders = {name: method.order for name, method in methods_of(release).items()}
    assert orders == {
        "euler": 1,
        "rk4": rk4,
        "implicit": implicit,
        "implicitfast": implicitfast,
        "discrete": 1,
    }


LISTED = """\
:env:.find-links='/opt/wheels'
global.cert='/etc/ssl/own.pem'
global.extra-index-url='https://a.example/simple https://b.example/simple'
global.find-links='/old'
global.index-url='https://c.example/simple'
global.timeout='60'
install.index-url='https://d.example/simple'
"""


def test_uv_is_told_what_pip_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Indexes, links and certificates, by pip's own order of precedence; no other settings."""
    for name in (*uv._UV_INDEXES, *uv._PIP_TO_UV.values()):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(uv, "_pip_config", lambda: LISTED)
    assert pip_settings() == {
        "UV_DEFAULT_INDEX": "https://d.example/simple",
        "UV_INDEX": "https://a.example/simple https://b.example/simple",
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_FIND_LINKS": "/opt/wheels",
        "SSL_CERT_FILE": "/etc/ssl/own.pem",
    }


@pytest.mark.parametrize("name", uv._UV_INDEXES)
def test_what_uv_is_told_itself_counts(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where uv has an index of its own, pip's settings are left alone."""
    monkeypatch.setattr(uv, "_pip_config", lambda: LISTED)
    monkeypatch.setenv(name, "https://e.example/simple")
    assert pip_settings() == {}


def test_without_uv_it_is_told_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """One line with the command."""
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(uv, "import_module", _no_module)
    with pytest.raises(UnavailableError, match=r"require uv: pip install 'bodycheck\[versions\]'"):
        uv.uv("--version")


def _no_module(name: str) -> None:
    raise ModuleNotFoundError(name)


class FakeUv:
    """Makes environments without a registry; it refuses a word of a command, or a constraint."""

    def __init__(self) -> None:
        self.refuses = "nothing"
        self.commands: list[tuple[str, ...]] = []
        self.constraints: list[str] = []

    def __call__(self, *words: str) -> str:
        """Do as uv would."""
        self.commands.append(words)
        if "-c" in words:
            self.constraints.append(Path(words[words.index("-c") + 1]).read_text())
        if words[0] == "venv":
            (Path(words[-1]) / "bin").mkdir(parents=True)
            (Path(words[-1]) / "bin" / "python").touch()
        if self.refuses in words or any(self.refuses in text for text in self.constraints[-1:]):
            raise UvError("no such version", refused=True)
        return ""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FakeUv:
    """Put a fake in uv's place, and the environments into a folder of the test."""
    made = FakeUv()
    monkeypatch.setattr(environments, "uv", made)
    monkeypatch.setattr(environments, "cache_home", lambda: tmp_path)
    return made


PIN = Pin("mujoco", "3.6.0")


def test_an_environment_is_made_once(fake: FakeUv) -> None:
    """The second time it is there; another version has another."""
    python = environments.python_of(PIN)
    made = len(fake.commands)
    assert environments.python_of(PIN) == python
    assert len(fake.commands) == made
    assert environments.python_of(Pin("mujoco", "3.7.0")) != python


def test_uv_is_asked_for_wheels_of_the_release_alone(fake: FakeUv) -> None:
    """For this Python, built nowhere, with what the worker imports, and no bodycheck of a registry's."""
    python = environments.python_of(PIN)
    venv, install = fake.commands
    assert venv[:3] == ("venv", "--python", sys.executable)
    assert install[:3] == ("pip", "install", "--python")
    assert Path(install[3]).parts[-2:] == ("bin", "python")
    assert "--no-build" in install
    assert install[-4:] == ("mujoco==3.6.0", "numpy", "numba", "pydantic")
    overrides = python.parents[1] / Path(install[install.index("--override") + 1]).name
    assert overrides.read_text() == "bodycheck ; python_version < '0'\n"


@pytest.mark.usefixtures("fake")
def test_the_folder_of_the_cache_need_not_be_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is made, with those above it."""
    monkeypatch.setattr(environments, "cache_home", lambda: tmp_path / "no" / "such")
    assert environments.python_of(PIN).exists()


@pytest.mark.usefixtures("fake")
def test_an_environment_is_told_of_before_it_is_made(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line on standard error, before anything is fetched; nothing where the environment is there."""
    told: list[str] = []
    monkeypatch.setattr(environments, "_make", lambda _pin, place: _make_now(place, told, capsys))
    environments.python_of(PIN)
    environments.python_of(PIN)
    assert told == ["making an environment for mujoco 3.6.0 ...\n"]
    assert capsys.readouterr().err == ""


def _make_now(place: Path, told: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Make an environment, and keep what was told before."""
    told.append(capsys.readouterr().err)
    (place / "bin").mkdir(parents=True)
    (place / "bin" / "python").touch()


def test_two_at_once_make_one_environment(fake: FakeUv) -> None:
    """Whoever comes second waits and finds it made."""
    threads = [threading.Thread(target=environments.python_of, args=(PIN,)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(words[0] == "venv" for words in fake.commands) == 1


def test_half_an_environment_never_counts(fake: FakeUv, tmp_path: Path) -> None:
    """One whose packages did not come is not left behind, and one that was cut off is no obstacle."""
    fake.refuses = "mujoco==3.6.0"
    with pytest.raises(UnavailableError, match=r"^mujoco==3.6.0 cannot be installed: no such version$"):
        environments.python_of(PIN)
    assert [path.name for path in (tmp_path / "environments").iterdir() if path.is_dir()] == []
    fake.refuses = "nothing"
    place = environments.python_of(PIN).parents[1]
    place.rename(place.with_name(f"{place.name}.part"))
    assert environments.python_of(PIN).exists()
    assert [path for path in (tmp_path / "environments").iterdir() if path.is_dir()] == [place]


def test_an_old_engine_may_need_older_libraries(fake: FakeUv) -> None:
    """Where it refuses numpy and numba as they are here, it gets those that it takes."""
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
    "UV_CONSTRAINT",
)


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("name", SOURCES)
def test_packages_from_elsewhere_make_another_environment(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What one index has under a version need not be what another has."""
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
    """Return where the user's configuration of uv is looked for, and the system's nowhere."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.delenv("UV_CONFIG_FILE", raising=False)
    monkeypatch.setattr(uv, "_SYSTEM_FILES", (tmp_path / "system.toml",))
    monkeypatch.setattr(uv, "_pip_config", lambda: "")
    (tmp_path / "config/uv").mkdir(parents=True)
    return tmp_path / "config/uv/uv.toml"


def test_the_users_configuration_counts_before_the_systems(
    users: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file that a variable names counts before both; where there is none, uv looks for no other."""
    assert uv._users_configuration() == {"UV_NO_CONFIG": "1"}
    for file in (tmp_path / "system.toml", users, tmp_path / "named.toml"):
        file.write_text("")
        if file.name == "named.toml":
            monkeypatch.setenv("UV_CONFIG_FILE", str(file))
        assert uv._users_configuration() == {"UV_CONFIG_FILE": str(file)}


@pytest.mark.usefixtures("fake")
def test_another_configuration_of_the_user_makes_another_environment(users: Path) -> None:
    """It may name another index under the same file."""
    places = [environments.python_of(PIN)]
    for text in ("no-index = true\n", "no-index = false\n"):
        users.write_text(text)
        places.append(environments.python_of(PIN))
    assert len({*places}) == 3


@pytest.mark.usefixtures("fake")
def test_environments_are_listed_and_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each with its engine, version and size, and where it came from without a password; half ones too."""
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
    assert list((tmp_path / "environments").iterdir()) == []


@pytest.mark.usefixtures("fake")
def test_the_commands_name_what_they_list_and_remove(tmp_path: Path) -> None:
    """One line per environment; a name removes all of that version; neither a name nor --all is refused."""
    places = [environments.python_of(pin).parents[1] for pin in (PIN, Pin("mujoco", "3.7.0"))]
    listed = bodycheck_in(tmp_path, "environments", "list").stdout.splitlines()
    lines = [line for line in listed if not line.startswith(" ")]
    assert lines == [f"mujoco==3.{6 + k}.0  0 MB  {place}" for k, place in enumerate(places)]
    for words, told in (
        ((), "give either names like mujoco==3.17.0 or --all"),
        (("mujoco==3.6.0", "--all"), "give either names like mujoco==3.17.0 or --all"),
        (("mujoco==3.8.0",), "no environment for mujoco==3.8.0 (available: mujoco==3.6.0, mujoco==3.7.0)"),
    ):
        refused = bodycheck_in(tmp_path, "environments", "remove", *words)
        assert refused.returncode == 2
        assert told in refused.stderr
    assert all(place.exists() for place in places)
    removed = bodycheck_in(tmp_path, "environments", "remove", "mujoco==3.6.0")
    assert removed.stdout.split() == [str(places[0])]
    assert [place.exists() for place in places] == [False, True]
    bodycheck_in(tmp_path, "environments", "remove", "--all")
    assert bodycheck_in(tmp_path, "environments", "list").stdout == ""


@pytest.mark.parametrize(("status", "said"), [(0, LISTED), (1, "")])
def test_pip_is_asked_from_nowhere_in_particular(
    status: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder `pip` of the working directory is not it; where there is no pip, nothing is configured."""
    asked: list[list[str]] = []

    def run(words: list[str], **_: object) -> CompletedProcess[str]:
        asked.append(words)
        return CompletedProcess(words, status, LISTED, "")

    monkeypatch.setattr(uv.subprocess, "run", run)
    assert uv._pip_config.__wrapped__() == said
    assert asked == [[sys.executable, "-P", "-m", "pip", "config", "list"]]


def test_what_uv_says_is_one_line_of_limited_length() -> None:
    """Without the marks of its tree; 400 characters stand as they are, and a longer text is cut off."""
    assert uv._in_one_line("error: no such package\n  ╰─▶ cause: it was withdrawn\n") == (
        "no such package it was withdrawn"
    )
    assert uv._in_one_line("x" * 400) == "x" * 400
    assert uv._in_one_line("x" * 401) == "x" * 400 + "..."
