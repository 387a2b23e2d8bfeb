"""The frame of all trials: options from the signature of a function, counts of planted faults, exit status.

    python tools/trials.py
    python tools/trials.py healthy_trials --scenarios 200 --seed 1

Lists the trials in this folder, or runs one. `python tools/healthy_trials.py --scenarios 200` does the same.
"""

from __future__ import annotations

import argparse
import inspect
import math
import os
import runpy
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, NoReturn, get_args, get_origin

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

if TYPE_CHECKING:
    from tests.helpers.child_process import ChildResult

ROOT = Path(__file__).resolve().parents[1]


class FaultFound(Exception):  # noqa: N818 - the result that trials search for
    """A trial that did not end as required."""


def command(*parts: Callable[..., object], own_cache: bool = False) -> NoReturn:
    """Call a function with the options of the command line; exit with status 1 if it returns what is wrong.

    `name: int = 1` is the option --name, `name: Path` and `*names: str` are positional, a tuple has one or
    more words. The first word names one of several functions. own_cache: nothing known is reused.
    """
    words, part = sys.argv[1:], parts[0]
    text = sys.modules["__main__"].__doc__ or ""
    if len(parts) > 1:
        by_name = {part.__name__.replace("_", "-"): part for part in parts}
        chooser = argparse.ArgumentParser(
            description=text, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        chooser.add_argument("trial", choices=by_name)
        part = by_name[chooser.parse_args(words[:1]).trial]
        text, words = inspect.getdoc(part) or "", words[1:]
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    listed = None
    for one in inspect.signature(part, eval_str=True).parameters.values():
        kinds = [kind for kind in get_args(one.annotation) if kind not in (NoneType, Ellipsis)]
        kind = kinds[0] if kinds else one.annotation
        if one.kind is one.VAR_POSITIONAL:
            listed = one.name
            parser.add_argument(one.name, type=kind, nargs="*")
        elif one.default is one.empty:
            parser.add_argument(one.name, type=kind)
        elif kind is bool:
            parser.add_argument(f"--{one.name.replace('_', '-')}", action="store_true")
        else:
            several = "+" if get_origin(one.annotation) is tuple else None
            option, default = f"--{one.name.replace('_', '-')}", one.default
            parser.add_argument(
                option, type=kind, nargs=several, default=default, help=f"[default: {default}]"
            )
    options = vars(parser.parse_intermixed_args(words))
    positional = options.pop(listed) if listed else ()
    if own_cache:
        os.environ.setdefault("BODYCHECK_CACHE_DIR", tempfile.mkdtemp())
    sys.exit(int(bool(part(*positional, **options))))


@dataclass
class Planted:
    """Trials with planted faults: how they ended, which failed, the slowest and the largest."""

    seed: int
    most_megabytes: float = math.inf
    begin: float = field(default_factory=time.monotonic)
    endings: Counter[str] = field(default_factory=Counter)
    failed: list[int] = field(default_factory=list)
    slowest_s: float = 0.0
    megabytes: float = 0.0

    def in_child(self, act: Callable[[], Any], limit_s: float) -> ChildResult:
        """Run a trial in a child process."""
        from tests.helpers.child_process import run_in_child  # mutation_trials.py imports a copy of tests/

        ended = run_in_child(act, limit_s)
        self.megabytes, self.slowest_s = (
            max(self.megabytes, ended.megabytes),
            max(self.slowest_s, ended.seconds),
        )
        return ended

    def add(self, number: int, ending: str, fault: str | None, about: str = "") -> None:
        """Count a trial by its ending; print and note it if it failed."""
        self.endings[ending] += 1
        if fault is not None:
            self.failed.append(number)
            print(f"trial {number}{about}: {fault[-1500:]}", flush=True)

    def summed_up(self, what: str) -> bool:
        """Print the figures; return whether a trial failed or needed too much memory."""
        seconds = time.monotonic() - self.begin
        print(f"{self.endings.total()} {what} of seed {self.seed} in {seconds:.0f} s")
        print(dict(sorted(self.endings.items())))
        if self.megabytes:
            print(f"slowest {self.slowest_s:.1f} s, at most {self.megabytes:.0f} MB")
        print(f"{len(self.failed)} failed" + (f": {self.failed}" if self.failed else ""))
        return bool(self.failed) or self.megabytes > self.most_megabytes


def _listed() -> None:
    """Print the name of each trial and the first line of its docstring."""
    for script in sorted(Path(__file__).parent.glob("*.py")):
        text = script.read_text(encoding="utf-8").partition('"""')[2].partition("\n")[0]
        print(f"{script.stem:22} {text}")


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
        _listed()
    else:
        sys.argv = [str(Path(__file__).with_name(f"{sys.argv[1]}.py")), *sys.argv[2:]]
        if not Path(sys.argv[0]).is_file():
            sys.exit(f"{Path(sys.argv[0]).stem}: no trial; `python tools/trials.py` lists them")
        runpy.run_path(sys.argv[0], run_name="__main__")
