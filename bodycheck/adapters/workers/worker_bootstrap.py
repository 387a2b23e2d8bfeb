"""Start a worker in an environment that has its engine but not bodycheck.

Run as `python -P THIS_FILE ENGINE MEMORY_BYTES`. bodycheck is imported from this file's location without
adding its parent folder to the path, which may be a site-packages with another version of the engine.
"""

from __future__ import annotations

import runpy
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path


def main() -> None:
    """Import bodycheck from this file's location and run its worker."""
    package = Path(__file__).resolve().parents[2]
    spec = spec_from_file_location(
        "bodycheck", package / "__init__.py", submodule_search_locations=[str(package)]
    )
    assert spec is not None
    assert spec.loader is not None
    bodycheck = module_from_spec(spec)
    sys.modules["bodycheck"] = bodycheck
    spec.loader.exec_module(bodycheck)
    runpy.run_module("bodycheck.adapters.workers.worker", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
