"""Describe the machine of a measurement: processor, cores, versions; nothing that identifies its owner."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

from bodycheck._util.platform_identity import cpu_model

_LIBRARIES = ("bodycheck", "numpy", "numba", "llvmlite", "scipy", "mujoco", "heyoka", "trimesh")


def machine() -> dict[str, object]:
    """Return plain data, without libraries that are not installed."""
    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "libraries": {name: found for name in _LIBRARIES if (found := _version(name))},
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
