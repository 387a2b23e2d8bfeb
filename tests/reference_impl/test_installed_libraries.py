"""What numbers depend on besides our sources is read where it is installed, without importing it."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from bodycheck._util import compiled_cache, platform_identity


@pytest.mark.parametrize("name", ["numpy", "numba", "llvmlite", "scipy"])
def test_a_library_is_its_version_and_a_hash_of_its_code(name: str) -> None:
    """Both stand in one word each."""
    number, digest = platform_identity.library_builds()[name].split()
    assert number == version(name)
    assert len(digest) == 16


def test_a_patched_library_is_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its sources and its libraries count, wherever they lie; its data do not."""
    package = tmp_path / "made_up"
    (package / "core").mkdir(parents=True)
    for name in ("__init__.py", "core/typing.py", "core/fast.so", "core/linked.so.3"):
        (package / name).touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    found = [platform_identity._build("made_up", ("made_up",))]
    (package / "core/notes.txt").write_text("data")
    assert platform_identity._build("made_up", ("made_up",)) == found[0]
    for name in ("core/typing.py", "core/fast.so", "core/linked.so.3"):
        (package / name).write_text("changed")
        found.append(platform_identity._build("made_up", ("made_up",)))
    assert len({*found}) == 4
    assert platform_identity._build("no_such_library", ()) is None


def test_nothing_is_imported_to_know_it() -> None:
    """Importing numba takes a second; reading its version from the installed files must not import it."""
    program = (
        "import sys; from bodycheck._util.platform_identity import numeric_parts; "
        "parts = numeric_parts(); sys.exit(bool({'numba', 'scipy', 'llvmlite'} & sys.modules.keys()))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.parametrize("name", ["OMP_NUM_THREADS", "NUMBA_OPT", "LD_PRELOAD", "NPY_DISABLE_CPU_FEATURES"])
def test_a_variable_that_counts_is_part_of_it(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Set or not, and to what; a long one by its hash."""
    found = set()
    monkeypatch.delenv(name, raising=False)
    found.add(platform_identity.environment())
    for value in ("1", "2", "x" * 1000, "y" * 1000):
        monkeypatch.setenv(name, value)
        found.add(platform_identity.environment())
        assert len(platform_identity.environment()) <= 500
    assert len(found) == 5


@pytest.mark.parametrize("name", ["NUMBA_CACHE_DIR", "PYTHONHASHSEED", "HOME", "OMPX"])
def test_a_variable_that_changes_no_number_is_not(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever its value."""
    monkeypatch.delenv(name, raising=False)
    before = platform_identity.environment()
    monkeypatch.setenv(name, "7")
    assert platform_identity.environment() == before


@pytest.mark.parametrize("changed", ["numba", "llvmlite", "NUMBA_OPT"])
def test_kernels_of_another_compiler_have_a_folder_of_their_own(
    changed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """numba's own cache knows its version, and neither a patch of it nor llvmlite nor its options."""
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


def test_the_processor_is_its_name_and_its_features(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another flag is another processor, in whatever order they stand."""
    found = []
    for flags in ("fpu sse2 avx2", "avx2 fpu sse2", "fpu sse2 avx2 avx512f"):
        file = tmp_path / "cpuinfo"
        file.write_text(f"processor : 0\nmodel name : one\nflags : {flags}\n\nprocessor : 1\nflags : x\n")
        monkeypatch.setattr(platform_identity, "_CPUINFO", file)
        found.append(platform_identity.processor.__wrapped__())
    assert found[0] == found[1] != found[2]
    assert found[0].startswith("one ")
    monkeypatch.setattr(platform_identity, "_CPUINFO", tmp_path / "none")
    assert isinstance(platform_identity.processor.__wrapped__(), str)
