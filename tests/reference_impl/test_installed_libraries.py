"""The identity of installed libraries, compiler and processor, read without importing them."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.metadata import distribution, version
from pathlib import Path

import pytest

from bodycheck._util import compiled_cache, platform_identity


@pytest.mark.parametrize("name", ["numpy", "numba", "llvmlite", "scipy"])
def test_library_is_its_version_and_a_hash_of_its_code(name: str) -> None:
    """The identity of a library is one text of its version and a hash."""
    number, digest = platform_identity.library_builds()[name].split()
    assert number == version(name)
    assert len(digest) == 16


@pytest.mark.parametrize("name", ["numpy", "numba", "llvmlite", "scipy"])
def test_hashed_folders_of_a_library_have_its_code(name: str) -> None:
    """The hashed folders are the package and that of its bundled libraries, which exists only in wheels."""
    site = Path(str(distribution(name).locate_file("")))
    listed = [site / folder for folder in platform_identity._FOLDERS[name]]
    assert {*site.glob(f"{name}.libs")} <= {*listed}
    folders = [folder for folder in listed if folder.suffix != ".libs"]
    assert folders
    assert all(any(folder.rglob("*.py")) for folder in folders)


def test_library_that_is_not_installed_has_no_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    """A library that is not installed has neither a build nor a folder."""
    monkeypatch.setattr(platform_identity, "_FOLDERS", {"numpy": ("numpy",), "no_such_library": ("x",)})
    assert [*platform_identity.library_builds.__wrapped__()] == ["numpy"]
    site = Path(str(distribution("numpy").locate_file("")))
    assert platform_identity.library_roots() == (str(site / "numpy"), str(site / "numpy.libs"))


def test_patched_library_has_another_identity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sources and shared libraries count, wherever they are in the package; its data do not."""
    package = tmp_path / "made_up"
    (package / "core").mkdir(parents=True)
    code = ("core/typing.py", *(f"core/fast.{kind}" for kind in ("so", "so.3", "pyd", "dll", "dylib")))
    for name in ("__init__.py", *code):
        (package / name).touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    found = [platform_identity._build("made_up", ("made_up",))]
    (package / "core/notes.txt").write_text("data")
    assert platform_identity._build("made_up", ("made_up",)) == found[0]
    for name in code:
        (package / name).write_text("changed")
        found.append(platform_identity._build("made_up", ("made_up",)))
    assert len({*found}) == len(found) == 7
    assert all(re.fullmatch("of no distribution [0-9a-f]{16}", build) for build in found)
    assert platform_identity._build("no_such_library", ()) is None


def test_identity_imports_nothing() -> None:
    """Importing numba takes a second, so its version is read from the installed files."""
    program = (
        "import sys; from bodycheck._util.platform_identity import numeric_parts; "
        "parts = numeric_parts(); sys.exit(bool({'numba', 'scipy', 'llvmlite'} & sys.modules.keys()))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_numbers_depend_on_python_libraries_processor_and_environment() -> None:
    """Each part is reported, and none is empty."""
    parts = platform_identity.numeric_parts()
    assert [*parts] == ["python", "numpy", "numba", "llvmlite", "scipy", "processor", "environment"]
    assert parts["python"] == f"{sys.implementation.name.replace('cp', 'CP')} {sys.version.split()[0]}"
    assert parts["processor"] == platform_identity.processor()
    assert parts["environment"] == platform_identity.environment()
    assert {name: parts[name] for name in ("numpy", "scipy")}.items() <= (
        platform_identity.library_builds().items()
    )


RESULT_VARIABLES = (
    *("OMP_NUM_THREADS", "MKL_CBWR", "OPENBLAS_CORETYPE", "GOTO_NUM_THREADS", "BLIS_NUM_THREADS"),
    *("VECLIB_MAXIMUM_THREADS", "NUMBA_OPT", "NPY_DISABLE_CPU_FEATURES", "GLIBC_TUNABLES"),
    *("LD_PRELOAD", "LD_LIBRARY_PATH", "LD_AUDIT", "DYLD_INSERT_LIBRARIES", "PYTHONOPTIMIZE"),
    *("LC_ALL", "LC_NUMERIC", "LANG", "CUDA_VISIBLE_DEVICES", "NVIDIA_TF32_OVERRIDE", "XLA_FLAGS"),
    *("JAX_ENABLE_X64", "TORCH_CUDNN_V8_API_DISABLED", "WARP_CACHE_PATH"),
)


@pytest.mark.parametrize("name", RESULT_VARIABLES)
def test_environment_variable_is_part_of_the_identity(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The value of the variable counts, a long one by its hash, and so does whether it is set."""
    found = set()
    monkeypatch.delenv(name, raising=False)
    found.add(platform_identity.environment())
    for value in ("1", "2", "x" * 1000, "y" * 1000):
        monkeypatch.setenv(name, value)
        found.add(platform_identity.environment())
        assert len(platform_identity.environment()) <= 500
    assert len(found) == 5


def test_variables_above_500_characters_are_hashed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Variables of up to 500 characters in total are listed unchanged."""
    monkeypatch.setenv("MADE_A", "1")
    monkeypatch.setenv("MADE_B", 484 * "x")
    listed = platform_identity.environment(["MADE_*"])
    assert (listed, len(listed)) == (f"MADE_A=1 MADE_B={484 * 'x'}", 500)
    monkeypatch.setenv("MADE_B", 485 * "x")
    assert re.fullmatch("2 variables [0-9a-f]{16}", platform_identity.environment(["MADE_*"]))


@pytest.mark.parametrize("name", ["NUMBA_CACHE_DIR", "PYTHONHASHSEED", "HOME", "OMPX"])
def test_irrelevant_variable_is_not_part_of_the_identity(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The value of an irrelevant variable does not change the identity."""
    monkeypatch.delenv(name, raising=False)
    before = platform_identity.environment()
    monkeypatch.setenv(name, "7")
    assert platform_identity.environment() == before


@pytest.mark.parametrize("changed", ["numba", "llvmlite", "NUMBA_OPT"])
def test_kernels_of_another_compiler_have_their_own_folder(
    changed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """numba's cache key has its own version only, not a patch, llvmlite or its options."""
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("BODYCHECK_KERNELS_FOR_NOW", raising=False)
    before = compiled_cache.cache_directory.__wrapped__()
    assert compiled_cache.cache_directory.__wrapped__() == before
    if changed == "NUMBA_OPT":
        monkeypatch.setenv("NUMBA_OPT", "1")
    else:
        others = {**platform_identity.library_builds(), changed: "0 other"}
        monkeypatch.setattr(platform_identity, "library_builds", lambda: others)
    assert compiled_cache.cache_directory.__wrapped__() != before


@pytest.mark.parametrize("listed", ["flags", "Features"])
def test_processor_is_its_name_and_its_features(
    listed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another flag means another processor, in any order of the flags; x86 and ARM use different keys."""
    found = []
    for flags in ("fpu sse2 avx2", "avx2 fpu sse2", "fpu sse2 avx2 avx512f"):
        file = tmp_path / "cpuinfo"
        file.write_text(f"processor : 0\nmodel name : one\n{listed} : {flags}\n\nprocessor : 1\nflags : x\n")
        monkeypatch.setattr(platform_identity, "_CPUINFO", file)
        found.append(platform_identity.processor.__wrapped__())
    assert found[0] == found[1] != found[2]
    assert re.fullmatch("one [0-9a-f]{8}", found[0])


def test_processor_that_is_not_listed_has_the_name_of_the_platform(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ARM lists features without a name, and other systems list nothing."""
    monkeypatch.setattr(platform_identity.platform, "machine", lambda: "arm64")
    monkeypatch.setattr(platform_identity.platform, "processor", lambda: "")
    monkeypatch.setattr(platform_identity, "_CPUINFO", tmp_path / "cpuinfo")
    assert platform_identity.processor.__wrapped__() == "arm64"
    (tmp_path / "cpuinfo").write_text("processor : 0\nFeatures : fp\n")
    assert re.fullmatch("arm64 [0-9a-f]{8}", platform_identity.processor.__wrapped__())
    assert platform_identity.cpu_model() == "arm64"
