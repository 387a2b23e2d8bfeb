"""The build identity: equal if nothing relevant changed, different if anything that affects results did."""

from __future__ import annotations

import _ctypes
import ctypes
import importlib
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterator
from importlib.metadata import distribution
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import bodycheck
from bodycheck._util.file_digests import files_below
from bodycheck._util.platform_identity import VARIABLES
from bodycheck.adapters import registry
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers import build_identity
from tests.helpers.compiled_engine_package import build_library, needs_a_compiler, write_shaky

needs_proc = pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="there is no /proc")

ANNOUNCED = """
import json, sys
from bodycheck.adapters.workers.build_identity import Loaded
from bodycheck.adapters.registry import get_adapter
loaded = Loaded(get_adapter(sys.argv[1]))
first = loaded.build
exec(sys.argv[2])
later = loaded.later()
print(json.dumps([vars(first), later and vars(later)]))
"""


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Return a folder with the package of the engine `shaky`."""
    write_shaky(tmp_path / "site")
    return tmp_path / "site"


@pytest.fixture(scope="module", autouse=True)
def _one_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let all tests share one cache of hashes, because hashing numba and others takes a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


def builds(engine: str, site: Path, then: str = "", **variables: str) -> list[Any]:
    """Return the builds of an engine in a new process, before and after it runs a piece of code."""
    path = os.pathsep.join((str(site), *filter(None, sys.path)))
    ended = subprocess.run(
        [sys.executable, "-P", "-c", ANNOUNCED, engine, then],
        env={**os.environ, "PYTHONPATH": path, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    found: list[Any] = json.loads(ended.stdout)
    return found


def touched(site: Path) -> None:
    """Change the time of a file and nothing else."""
    os.utime(site / "shaky" / "table.dat", (1e9, 1e9))


UNCHANGED: dict[str, tuple[Callable[[Path], object], dict[str, str]]] = {
    "nothing": (lambda site: None, {}),  # noqa: ARG005
    "a time": (touched, {}),
    "bytecode": (lambda site: (site / "shaky/__pycache__/x.pyc").write_bytes(b"x"), {}),
    "an idle variable": (lambda site: None, {"PYTHONHASHSEED": "7", "NUMBA_CACHE_DIR": "x"}),  # noqa: ARG005
    "a library rebuilt from the same source": (lambda site: build_library(site, 1.0), {}),
}


def another_numba(site: Path) -> None:
    """Put another numba before the installed one."""
    (site / "numba").mkdir()
    (site / "numba/__init__.py").write_text("__version__ = '99'\n")


CHANGED: dict[str, tuple[Callable[[Path], object], dict[str, str], str]] = {
    "a library beside it": (lambda site: build_library(site, 1.5), {}, "adapter"),
    "a patched module": (lambda site: (site / "shaky/second.py").write_text("FACTOR = 2.0\n"), {}, "adapter"),
    "a data file": (lambda site: (site / "shaky/table.dat").write_text("1 2 4\n"), {}, "adapter"),
    "a new file": (lambda site: (site / "shaky/more.py").write_text(""), {}, "adapter"),
    "a file that is gone": (lambda site: (site / "shaky/table.dat").unlink(), {}, "adapter"),
    "another numba": (another_numba, {}, "numba"),
    "threads": (lambda site: None, {"OMP_NUM_THREADS": "3"}, "environment"),  # noqa: ARG005
    "a variable of the engine": (lambda site: None, {"SHAKY_MODE": "fast"}, "environment"),  # noqa: ARG005
}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@needs_a_compiler
@pytest.mark.parametrize("what", UNCHANGED)
def test_identity_ignores_what_cannot_change_results(what: str, site: Path) -> None:
    """Times, bytecode and irrelevant environment variables are not part of the identity."""
    before, _ = builds("shaky", site)
    UNCHANGED[what][0](site)
    after, _ = builds("shaky", site, **UNCHANGED[what][1])
    assert before["id"] == after["id"] != ""
    assert before["kind"] == "plug-in"


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@needs_a_compiler
@pytest.mark.parametrize("what", CHANGED)
def test_identity_changes_with_each_part(what: str, site: Path) -> None:
    """A changed part changes the identity, and only that part differs."""
    change, variables, part = CHANGED[what]
    before, _ = builds("shaky", site)
    change(site)
    after, _ = builds("shaky", site, **variables)
    assert before["id"] != after["id"]
    parts = before["parts"].keys() | after["parts"].keys()
    assert {p for p in parts if before["parts"].get(p) != after["parts"].get(p)} == {part}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@needs_a_compiler
@needs_proc
@pytest.mark.parametrize(
    ("then", "counts"),
    [
        ("", False),
        ("import wave", False),
        ("import shaky.third", False),
        ("import bodycheck.reports.gates.thresholds", False),
        ("import elsewhere", True),
        ("import jinja2.sandbox", True),
        ("import ctypes; ctypes.CDLL(sys.path[0] + '/libelsewhere.so')", True),
        ("import ctypes; ctypes.CDLL(sys.path[0] + '/a folder/libelsewhere.so')", True),
    ],
)
def test_code_loaded_later_from_elsewhere_changes_the_identity(then: str, counts: bool, site: Path) -> None:
    """Modules and libraries from other folders count; those of Python and of the package do not."""
    (site / "shaky/third.py").touch()
    (site / "elsewhere.py").touch()
    (site / "a folder").mkdir()
    for folder in (site, site / "a folder"):
        shutil.copy(site / "shaky/libshaky.so", folder / "libelsewhere.so")
    then = then.replace("sys.path[0]", repr(str(site)))
    first, later = builds("shaky", site, then)
    assert first["id"]
    assert (later is not None) is counts
    if counts:
        assert later["id"] not in ("", first["id"])


@needs_a_compiler
def test_lazy_module_is_not_imported_by_the_identity(site: Path) -> None:
    """Computing the identity inspects the imported modules but imports no other module."""
    lazy = (
        "import sys, types\nclass Lazy(types.ModuleType):\n"
        "    def __getattr__(self, name):\n        raise ImportError(name)\n"
        "sys.modules['lazy'] = Lazy('lazy')\n"
    )
    (site / "shaky/second.py").write_text(f"{lazy}FACTOR = 1.0\n")
    first, _ = builds("shaky", site)
    assert first["id"]


@needs_a_compiler
@needs_proc
def test_library_replaced_while_loaded_has_no_identity(site: Path) -> None:
    """The file on disk is not the loaded one, so no answer can be stored."""
    shutil.copy(site / "shaky/libshaky.so", site / "libelsewhere.so")
    place = str(site / "libelsewhere.so")
    load = f"import ctypes, os; ctypes.CDLL({place!r}); os.unlink({place!r})"
    first, later = builds("shaky", site, load)
    assert first["id"]
    assert later["id"] == ""


@needs_a_compiler
def test_file_changed_during_import_leaves_no_identity(site: Path) -> None:
    """There is no identity, because the imported code may be older than the hashed file."""
    text = (site / "shaky/__init__.py").read_text()
    slow = "import bodycheck.adapters.workers.build_identity\n"
    slow += "(Path(__file__).parent / 'table.dat').write_text('4 5 6')\n"
    (site / "shaky/__init__.py").write_text(text + slow)
    first, _ = builds("shaky", site)
    assert first["id"] == ""


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "dart", "reference"])
def test_installed_engine_lists_its_parts(engine: str, tmp_path: Path) -> None:
    """The build lists Python, libraries, processor, bodycheck's code and the engine's distribution."""
    name = {"dart": "dartpy"}.get(engine, engine)
    if engine != "reference":
        pytest.importorskip(name)
    # packages installed next to an installed engine are assumed to be unmodified
    first, later = builds(engine, tmp_path, "import jinja2.sandbox")
    assert later is None
    assert first["kind"] == "installed"
    assert len(first["id"]) == 64
    needed = {"python", "numpy", "numba", "llvmlite", "processor", "environment", "bodycheck", "loaded"}
    assert needed <= first["parts"].keys()
    assert all(len(first["parts"][name].split()[-1]) == 16 for name in ("numpy", "loaded", "bodycheck"))
    assert first["parts"].get("distribution", "").startswith("" if engine == "reference" else f"{name} ")
    # the other engines are single files
    assert ("engine" in first["parts"]) is (engine == "mujoco")
    # the adapter belongs to bodycheck, and few engines have libraries outside their package
    assert "adapter" not in first["parts"]
    libraries = engine != "reference" and Path(str(distribution(name).locate_file(f"{name}.libs"))).is_dir()
    assert ("engine libraries" in first["parts"]) is libraries


@pytest.mark.parametrize(
    ("record", "kind"),
    [
        (None, "installed"),
        ('{"dir_info": {"editable": true}}', "development"),
        ('{"dir_info": {}}', "installed"),
        ("[", "development"),
    ],
)
def test_editable_engine_is_a_development_build(
    record: str | None, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An editable install may change at any time; an unreadable record counts as an editable install."""
    installed = SimpleNamespace(
        read_text=lambda _: record, locate_file=distribution("numpy").locate_file, files=None
    )
    monkeypatch.setattr(build_identity, "distribution_of", lambda _: "numpy")
    monkeypatch.setattr(build_identity, "installed", lambda _: installed)
    assert build_identity._kind(Reference()) == kind


def test_package_of_a_distribution_with_a_hyphen_is_hashed_as_a_whole(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The package of the distribution `some-engine` is `some_engine`."""
    package = ModuleType("some_engine")
    package.__path__ = [str(tmp_path)]
    monkeypatch.setitem(sys.modules, "some_engine", package)
    monkeypatch.setattr(build_identity, "distribution_of", lambda _: "some-engine")
    adapter: Any = SimpleNamespace(name="mine")
    assert ("engine", str(tmp_path)) in list(build_identity._roots(adapter))


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("package", "counts"),
    [("yaml", False), ("coverage", False), ("charset_normalizer", False), ("jinja2", True), ("yaml2", True)],
)
def test_packages_that_numba_imports_do_not_change_a_plug_in(
    package: str, counts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Packages that numba imports if they are installed do not count, because they do not change results."""
    loaded = build_identity.Loaded(Reference(), handed_over=True)
    module = ModuleType("made_up_module")
    module.__file__ = str(Path(sysconfig.get_path("purelib"), package, "made_up.py"))
    monkeypatch.setitem(sys.modules, "made_up_module", module)
    assert (loaded.later() is not None) is counts


@pytest.mark.parametrize("time", ["modified", "changed"])
def test_file_newer_than_the_process_leaves_no_identity(
    time: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Times are compared to the nanosecond, and a file as old as the process is not newer."""
    (tmp_path / "a.py").touch()
    if time == "changed":
        os.utime(tmp_path / "a.py", (1e9, 1e9))
    files = files_below(str(tmp_path))
    ((_, status),) = files.values()
    monkeypatch.setattr(build_identity.Loaded, "_elsewhere", lambda _: {})  # modules of other tests are newer
    for early_ns in (0, 1):
        loaded = build_identity.Loaded(Reference(), handed_over=True)
        monkeypatch.setattr(
            build_identity, "_BEGIN_NS", max(status.st_mtime_ns, status.st_ctime_ns) - early_ns
        )
        loaded._content("made up", files)
        assert (loaded._with_elsewhere(loaded.build).id == "") is bool(early_ns)


def test_files_behind_a_link_are_recognised(tmp_path: Path) -> None:
    """A linked folder is recognised by both paths: Python uses that of the link, /proc the real one."""
    (tmp_path / "site").mkdir()
    (tmp_path / "link").symlink_to("site")
    link, site = (f"{tmp_path / name}{os.sep}" for name in ("link", "site"))
    assert build_identity._prefixes([link.rstrip(os.sep)]) == (link, site)
    assert build_identity._prefixes([site.rstrip(os.sep)]) == (site,)


def test_own_package_is_hashed_by_its_sources() -> None:
    """The identity covers the folder of the package, so its modules do not count as loaded from elsewhere."""
    assert build_identity._own_package() == str(Path(bodycheck.__file__).parent)


MAPS = b"""\
7f00-7f01 r--p 00000000 fe:01 1 /opt/data.bin
7f01-7f02 r-xp 00000000 fe:01 2 /opt/a folder/a.so
7f02-7f03 r--p 00001000 fe:01 2 /opt/a folder/a.so
7f03-7f04 r-xp 00001000 fe:01 2 /opt/a folder/a.so
7f04-7f05 r-xp 00000000 fe:01 3 /opt/\xff/a.so
7f05-7f06 rwxp 00000000 00:00 0
7f06-7f07 r-xp 00000000 00:00 0 [vdso]
"""


@pytest.mark.slow
@pytest.mark.parametrize("room", ["_util", "reference_impl", "adapters"])
def test_identity_changes_with_each_room_of_bodycheck(room: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A change to an adapter, integrator or helper changes the identity, even in an installed bodycheck."""
    before = build_identity.Loaded(Reference()).build
    digest_of = registry.digest_of
    monkeypatch.setattr(
        registry, "digest_of", lambda folder: "0" * 64 if folder.name == room else digest_of(folder)
    )
    registry.own_code.cache_clear()
    try:
        after = build_identity.Loaded(Reference()).build
    finally:
        registry.own_code.cache_clear()
    assert after.id != before.id
    assert {name for name in before.parts if before.parts[name] != after.parts[name]} == {"bodycheck"}


@pytest.mark.slow
def test_libraries_are_the_mapped_files_with_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A library with the name of another one is listed with its path; without /proc there are none."""
    (tmp_path / "maps").write_bytes(MAPS)
    loaded = build_identity.Loaded(Reference())
    monkeypatch.setattr(build_identity, "_imported", lambda: ())
    monkeypatch.setattr(build_identity, "_MAPS", tmp_path / "maps")
    first, other = "/opt/a folder/a.so", "/opt/\udcff/a.so"
    assert loaded._elsewhere() == {"library a.so": first, f"library a.so {other}": other}
    monkeypatch.setattr(build_identity, "_MAPS", tmp_path / "none")
    assert loaded._elsewhere() == {}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("installed", [True, False])
def test_files_of_python_and_of_the_system_are_trusted(installed: bool) -> None:
    """Files of other packages are trusted only for an installed engine, and files elsewhere never."""
    loaded = build_identity.Loaded(Reference(), handed_over=not installed)
    site, standard = sysconfig.get_path("purelib"), sysconfig.get_path("stdlib")
    assert loaded.build.kind == ("installed" if installed else "handed over")
    assert loaded._is_trusted(f"{site}/jinja2/sandbox.py") is installed
    assert loaded._is_trusted(f"{site}/coverage/data.py")
    assert all(loaded._is_trusted(path) for path in (f"{standard}/wave.py", "/usr/lib/x.so", "/lib64/x.so"))
    assert not loaded._is_trusted("/opt/x.so")
    assert not loaded._is_trusted("/usr/library/x.so")


@needs_proc
def test_each_loaded_library_is_counted_once(tmp_path: Path) -> None:
    """The count increases by one for each library, whoever loaded it."""
    before = build_identity._libraries_ever_loaded()
    assert before >= len(dict(build_identity._mapped())) > 0
    for number in (1, 2):
        copy = shutil.copy(_ctypes.__file__, tmp_path / f"{number}.so")
        ctypes.CDLL(str(copy))
        assert build_identity._libraries_ever_loaded() == before + number


def test_variables_start_with_the_name_of_the_engine() -> None:
    """Prefixes are in capitals with underscores for hyphens, for the engine's name and its package's."""
    assert build_identity._variables_of("my-engine") == ("MY_ENGINE_*",)
    assert build_identity._variables_of("dart") == ("DART_*", "DARTPY_*")


@pytest.mark.parametrize("linked", ["the folder", "the package"])
def test_installed_engine_is_found_through_a_link(
    linked: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """lib64 is often a link to lib, and packages behind the link are installed too."""
    site, link = tmp_path / "site", tmp_path / "link"
    (site / "made_up_engine-1.dist-info").mkdir(parents=True)
    facts = "Metadata-Version: 2.1\nName: made_up_engine\nVersion: 1\n"
    (site / "made_up_engine-1.dist-info" / "METADATA").write_text(facts)
    (site / "made_up_engine").mkdir()
    (site / "made_up_engine" / "__init__.py").touch()
    if linked == "the folder":
        link.symlink_to(site)
    else:
        link.mkdir()
        (link / "made_up_engine").symlink_to(site / "made_up_engine")
        monkeypatch.syspath_prepend(str(site))
    monkeypatch.syspath_prepend(str(link))
    assert build_identity._is_installed("made_up_engine")


@pytest.mark.parametrize(
    ("direct_url", "origin", "installed"),
    [
        (None, "site", True),
        ({"url": "file:///x.whl", "archive_info": {}}, "site", True),
        ({"url": "file:///x", "dir_info": {}}, "site", True),
        ({"url": "file:///x", "dir_info": {"editable": True}}, "site", False),
        (["no object"], "site", False),
        (None, "sources", False),
    ],
)
def test_editable_engine_is_not_installed(
    direct_url: Any,
    origin: str,
    installed: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An editable install and a package in a source folder both count as development."""
    facts = tmp_path / "site" / "made_up_engine-1.dist-info"
    facts.mkdir(parents=True)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: made_up_engine\nVersion: 1\n")
    if direct_url is not None:
        (facts / "direct_url.json").write_text(json.dumps(direct_url))
    package = tmp_path / origin / "made_up_engine"
    package.mkdir(parents=True, exist_ok=True)
    (package / "__init__.py").touch()
    for folder in {"site", origin}:
        monkeypatch.syspath_prepend(str(tmp_path / folder))
    assert build_identity._is_installed("made_up_engine") is installed
    assert not build_identity._is_installed("no_such_engine")


@pytest.mark.parametrize(
    "file", ["cmeel.prefix/lib/python3/site-packages/inner/__init__.py", "inner/part/x.py"]
)
def test_engine_is_installed_under_another_name_than_its_package(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The modules of a distribution are those of its RECORD, as pin provides pinocchio."""
    facts = tmp_path / "outer_name-1.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: outer-name\nVersion: 1\n")
    (facts / "RECORD").write_text(f"{file},,\n../../bin/outer.py,,\n")
    package = tmp_path / file.partition("inner")[0] / "inner"
    (tmp_path / file).parent.mkdir(parents=True)
    (package / "__init__.py").touch()
    for folder in {tmp_path, package.parent}:
        monkeypatch.syspath_prepend(str(folder))
    assert build_identity._is_installed("outer-name")
    shutil.rmtree(package)
    importlib.invalidate_caches()
    assert not build_identity._is_installed("outer-name")


def test_every_variable_has_a_reason() -> None:
    """Each environment variable of the list has a reason why it counts."""
    assert all(reason.strip() for reason in VARIABLES.values())
    assert {"OMP_*", "MKL_*", "OPENBLAS_*", "NUMBA_*", "LD_PRELOAD", "LD_LIBRARY_PATH"} <= VARIABLES.keys()


VERSION = """
import sys
import {package}
import importlib.metadata as metadata
known = metadata.version
metadata.version = lambda name: "99.9" if name == "{package}" else known(name)
{package}.__version__ = "99.9"
from bodycheck.adapters.registry import get_adapter
print(get_adapter("{engine}").version)
"""


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("engine", "package"), [("dart", "dartpy"), ("mujoco", "mujoco"), ("pybullet", "pybullet")]
)
def test_engine_announces_the_version_of_its_package(engine: str, package: str) -> None:
    """The version is read from the installed package and is not a constant of the adapter."""
    pytest.importorskip(package)
    program = VERSION.format(engine=engine, package=package)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ended.stdout.split()[-1:] == ["99.9"], ended.stderr
