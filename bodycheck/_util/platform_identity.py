"""Identity of the platform that affects numerical results: installed libraries, processor, environment."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterable
from fnmatch import fnmatchcase
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from bodycheck._util.distributions import installed
from bodycheck._util.file_digests import content_digest, files_below

_FOLDERS = {
    "numpy": ("numpy", "numpy.libs"),
    "numba": ("numba",),
    "llvmlite": ("llvmlite",),
    "scipy": ("scipy/linalg", "scipy/_lib", "scipy.libs"),
}
"""Library -> the folders whose code can change a number; numba calls the BLAS of scipy."""
_LONGEST = 500
_CPUINFO = Path("/proc/cpuinfo")

VARIABLES: dict[str, str] = {
    "OMP_*": "number of threads that share a sum, and so the order of summation",
    "MKL_*": "the same; MKL_CBWR selects the code path of multiplication",
    "OPENBLAS_*": "the same; OPENBLAS_CORETYPE selects the kernels",
    "GOTO_NUM_THREADS": "an older name of OPENBLAS_NUM_THREADS",
    "BLIS_*": "threads and kernels of BLIS",
    "VECLIB_*": "threads of Accelerate",
    "NUMBA_*": "how kernels are compiled: NUMBA_OPT, NUMBA_CPU_NAME, NUMBA_DISABLE_JIT and others",
    "NPY_*": "which of numpy's dispatched loops are used: NPY_DISABLE_CPU_FEATURES",
    "GLIBC_TUNABLES": "which variants of libm's functions are chosen",
    "LD_PRELOAD": "code that replaces other code of the same name",
    "LD_LIBRARY_PATH": "where libraries are searched first",
    "LD_AUDIT": "code that redirects calls",
    "DYLD_*": "the same on macOS",
    "PYTHONOPTIMIZE": "whether assertions are executed",
    "LC_ALL": "how a locale-dependent engine reads a decimal point",
    "LC_NUMERIC": "the same",
    "LANG": "the same if neither LC_ALL nor LC_NUMERIC is set",
    "CUDA_VISIBLE_DEVICES": "which device computes",
    "NVIDIA_TF32_OVERRIDE": "precision of a device",
    "XLA_FLAGS": "how kernels of XLA are compiled",
    "JAX_*": "precision and device of JAX",
    "TORCH_*": "kernels and device of PyTorch",
    "WARP_*": "how kernels of Warp are compiled",
}
"""Environment variables known to change results, and how.

PYTHONHASHSEED is left out because without it each process hashes strings differently anyway, NUMBA_CACHE_DIR
because it affects no result.
"""
_WITHOUT_EFFECT = ("NUMBA_CACHE_DIR",)


@cache
def library_builds() -> dict[str, str]:
    """Return name -> version and hash of the code of each installed library, without importing it."""
    found = ((name, _build(name, folders)) for name, folders in _FOLDERS.items())
    return {name: build for name, build in found if build is not None}


def library_roots() -> tuple[str, ...]:
    """Return the folders of the libraries that affect results."""
    sites = {name: _site(name) for name in _FOLDERS}
    return tuple(
        os.path.join(site, folder)  # noqa: PTH118 - paths in sys.modules and /proc/self/maps are strings
        for name, site in sites.items()
        if site is not None
        for folder in (name, f"{name}.libs")
    )


def _is_code(path: str) -> bool:
    return path.endswith((".py", ".so", ".pyd", ".dll", ".dylib")) or ".so." in path.rpartition("/")[2]


def _site(name: str) -> str | None:
    spec = find_spec(name)
    origin = None if spec is None else spec.origin
    return None if origin is None else str(Path(origin).parents[1])


def _build(name: str, folders: Iterable[str]) -> str | None:
    site = _site(name)
    if site is None:
        return None
    files = {
        f"{folder}/{place}": file
        for folder in folders
        for place, file in files_below(str(Path(site, folder))).items()
        if _is_code(place)
    }
    found = installed(name)
    number = "of no distribution" if found is None else found.version
    return f"{number} {content_digest(f'{name} {site}', files)[:16]}"


@cache
def processor() -> str:
    """Return the processor's name and a hash of its features, by which numpy, numba and libm dispatch."""
    facts = _cpu_facts()
    if not facts:
        return f"{platform.processor()} {platform.machine()}".strip()
    features = " ".join(sorted((facts.get("flags") or facts.get("Features") or "").split()))
    return f"{cpu_model()} {hashlib.sha256(features.encode()).hexdigest()[:8]}"


def cpu_model() -> str:
    """Return the name of the processor, or of its architecture where Linux states no name."""
    return _cpu_facts().get("model name") or platform.machine()


def usable_cores() -> int:
    """Return the number of cores that this process may use; all of them on systems that do not tell."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cpu_facts() -> dict[str, str]:
    """Return what /proc/cpuinfo states of the first processor, by name; nothing where it does not exist."""
    try:
        block = _CPUINFO.read_bytes().decode().partition("\n\n")[0]
    except OSError:
        return {}
    lines = (line.partition(":") for line in block.splitlines())
    return {name.strip(): value.strip() for name, _, value in lines}


def environment(patterns: Iterable[str] = VARIABLES) -> str:
    """Return the variables that match the patterns, with their values; a hash if that is long."""
    patterns = tuple(patterns)
    found = [
        f"{name}={value}"
        for name, value in sorted(os.environ.items())
        if name not in _WITHOUT_EFFECT and any(fnmatchcase(name, pattern) for pattern in patterns)
    ]
    text = " ".join(found)
    if len(text) <= _LONGEST:
        return text
    return f"{len(found)} variables {hashlib.sha256(text.encode()).hexdigest()[:16]}"


def compiler() -> str:
    """Return what determines compiled kernels: builds of numba and llvmlite, and numba's variables."""
    builds = library_builds()
    return f"{builds.get('numba')} {builds.get('llvmlite')} {environment(['NUMBA_*'])}"


def numeric_parts() -> dict[str, str]:
    """Return everything besides bodycheck's sources that affects its results: Python, libraries, platform."""
    return {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        **library_builds(),
        "processor": processor(),
        "environment": environment(),
    }
