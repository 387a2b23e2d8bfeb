"""Run `smoke` with a release of an engine, or list the releases that must pass it.

python scripts/engine_releases.py list: prints the newest release and the declared lower bound of each engine
that runs on request, as a JSON array of names for --engine.
python scripts/engine_releases.py NAME: runs smoke with one of them, and exits with 1 if a case is neither
measured nor unsupported.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator

import bodycheck
from bodycheck.adapters.registry import distribution_of, optional_engines, stated_by

_BOUND = re.compile(r"(?P<package>@?[A-Za-z0-9._/-]+?)(\[[a-z,]+\])?@?>=(?P<version>[0-9.]+)")
ALLOWED = {"ok", "unsupported"}


def releases() -> Iterator[str]:
    """Yield NAME, the newest release, and NAME==LOWEST of each engine."""
    for engine in optional_engines():
        yield engine
        stated, package = stated_by(engine), distribution_of(engine)
        for bound in map(_BOUND.fullmatch, getattr(stated, "requires", ())):
            if bound is not None and bound["package"] == package:
                missing = 2 - bound["version"].count(".")
                yield f"{engine}=={bound['version']}{'.0' * missing}"


def main(name: str) -> int:
    """Print the releases, or run one; return the exit status."""
    if name == "list":
        print(json.dumps(list(releases())))
        return 0
    found = bodycheck.run(["smoke"], engines=[name], speed=False)
    wrong = found.results[~found.results["outcome"].isin(ALLOWED)]
    for row in wrong.to_dict("records"):
        print(f"{row['engine']}:{row['method']} {row['scenario']}: {row['outcome']}: {row['message']}")
    print(f"{name}: {len(found.results)} cases, {len(wrong)} wrong")
    return int(len(wrong) > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
