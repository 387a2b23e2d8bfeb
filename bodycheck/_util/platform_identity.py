"""What numbers depend on besides our own sources: libraries as they are installed, processor, environment."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterable
from fnmatch import fnmatchcase
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from bodycheck._util.file_digests import content_digest, files_below

_FOLDERS = {
    "numpy": ("numpy", "numpy.libs"),
    "numba": ("numba",),
    "llvmlite": ("llvmlite",),
    "scipy": ("scipy/linalg", "scipy/_lib", "scipy.libs"),
}
"""Of each library the folders beside its package that can change a number: numba calls the BLAS of scipy."""
_LONGEST = 500
_CPUINFO = Path("/proc/cpuinfo")

VARIABLES: dict[str, str] = {
    "OMP_*": "how many threads share a sum, and so its order",
    "MKL_*": "the same, and MKL_CBWR which code path multiplies",
    "OPENBLAS_*": "the same, and OPENBLAS_CORETYPE the kernels",
    "GOTO_NUM_THREADS": "an older name of OPENBLAS_NUM_THREADS",
    "BLIS_*": "threads and kernels of BLIS",
    "VECLIB_*": "threads of Accelerate",
    "NUMBA_*": "how kernels are compiled: NUMBA_OPT, NUMBA_CPU_NAME, NUMBA_DISABLE_JIT and others",
    "NPY_*": "which of numpy's dispatched loops are used: NPY_DISABLE_CPU_FEATURES",
    "GLIBC_TUNABLES": "which variants of libm's functions are chosen",
    "LD_PRELOAD": "code that takes the place of other code of the same name",
    "LD_LIBRARY_PATH": "where libraries of a name are looked for first",
    "LD_AUDIT": "code that redirects calls",
    "DYLD_*": "the same on macOS",
    "PYTHONOPTIMIZE": "whether assertions are executed",
    "LC_ALL": "how an engine that heeds the locale reads a decimal point",
    "LC_NUMERIC": "the same",
    "LANG": "the same where those two are not set",
    "CUDA_VISIBLE_DEVICES": "which device computes",
    "NVIDIA_TF32_OVERRIDE": "how many digits a device keeps",
    "XLA_FLAGS": "how kernels of XLA are compiled",
    "JAX_*": "precision and device of JAX",
    "TORCH_*": "kernels and device of PyTorch",
    "WARP_*": "how kernels of Warp are compiled",
}
"""Environment variables known to change what is computed, and why.

PYTHONHASHSEED is not among them: without it each process already hashes texts in its own way. NUMBA_CACHE_DIR
is left out: it says where, not what.
"""
_IDLE = ("NUMBA_CACHE_DIR",)


@cache
def library_builds() -> dict[str, str]:
    """Return name -> version and a hash of the code, of each library that is there; none is imported."""
    found = ((name, _build(name, folders)) for name, folders in _FOLDERS.items())
    return {name: build for name, build in found if build is not None}


def library_roots() -> tuple[str, ...]:
    """Return the folders of these libraries."""
    sites = {name: _site(name) for name in _FOLDERS}
    return tuple(
        os.path.join(site, folder)  # noqa: PTH118 - paths of sys.modules and maps are texts
        for name, site in sites.items()
        if site is not None
        for folder in (name, f"{name}.libs")
    )


def _is_code(name: str) -> bool:
    return name.endswith((".py", ".so", ".pyd", ".dll", ".dylib")) or ".so." in name


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
        for place, file in files_below(str(Path(site, folder)), _is_code).items()
    }
    try:
        number = version(name)
    except PackageNotFoundError:
        number = "of no distribution"
    return f"{number} {content_digest(f'{name} {site}', files)[:16]}"


@cache
def processor() -> str:
    """Return the processor's name and a hash of its features, which numpy, numba and libm dispatch on."""
    try:
        block = _CPUINFO.read_text(encoding="utf-8").partition("\n\n")[0]
    except OSError:
        return f"{platform.processor()} {platform.machine()}".strip()
    lines = (line.partition(":") for line in block.splitlines())
    facts = {name.strip(): value.strip() for name, _, value in lines}
    features = " ".join(sorted((facts.get("flags") or facts.get("Features") or "").split()))
    name = facts.get("model name") or platform.machine()
    return f"{name} {hashlib.sha256(features.encode()).hexdigest()[:8]}"


def environment(patterns: Iterable[str] = VARIABLES) -> str:
    """Return the variables of these names that are set, with their values; their hash where that is long."""
    patterns = tuple(patterns)
    found = [
        f"{name}={value}"
        for name, value in sorted(os.environ.items())
        if name not in _IDLE and any(fnmatchcase(name, pattern) for pattern in patterns)
    ]
    text = " ".join(found)
    if len(text) <= _LONGEST:
        return text
    return f"{len(found)} variables {hashlib.sha256(text.encode()).hexdigest()[:16]}"


def compiler() -> str:
    """Return what kernels are compiled by: builds of numba and llvmlite, and numba's variables."""
    builds = library_builds()
    return f"{builds.get('numba')} {builds.get('llvmlite')} {environment(['NUMBA_*'])}"


def numeric_parts() -> dict[str, str]:
    """Return all of it, with Python: what our own computations depend on besides our sources."""
    return {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        **library_builds(),
        "processor": processor(),
        "environment": environment(),
    }
