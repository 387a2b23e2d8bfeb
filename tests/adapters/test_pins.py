"""Engines in versions of their own: what is asked for, what uv is told, what is known of each version."""

from __future__ import annotations

import threading
from importlib.metadata import version
from pathlib import Path

import pytest

from bodycheck.adapters import environments, uv
from bodycheck.adapters.mujoco_methods import methods_of
from bodycheck.adapters.pins import Pin, engine_fault, pin_of
from bodycheck.adapters.uv import UvError, pip_settings
from bodycheck.errors import UnavailableError


def test_a_pin_is_written_as_pip_writes_it() -> None:
    """NAME==VERSION is that, and reads back; a name alone is none."""
    assert pin_of("mujoco==3.6.0") == Pin("mujoco", "3.6.0")
    assert Pin("mujoco", "3.6.0").name == "mujoco==3.6.0"
    assert pin_of("mujoco") is None


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("mujoco==3.*", "'3.*' is no version"),
        ("mujoco==", "'' is no version"),
        ("mujoco===3.6.0", "'=3.6.0' is no version"),
        ("mujoco==3.6.0 --index-url=http://elsewhere", "is no version"),
        ("mujoco==3.x", "'3.x' is no version"),
        ("havok==1.0", "no engine is named 'havok'"),
        ("mujoco>=3.6", "no engine is named 'mujoco>=3.6'"),
        ("mujoco=3.6.0", "a version is asked for by two signs: mujoco==3.6.0"),
        ("mujoco=", "a version is asked for by two signs: mujoco==4.0.0"),
        ("havok=1.0", "no engine is named 'havok=1.0'"),
        ("reference==0.1", "part of this program"),
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
    with pytest.raises(UnavailableError, match=r"need uv: pip install 'bodycheck\[versions\]'"):
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
