"""Plant small random faults in the code that measures and judges, and count how many the tests detect.

    bash tools/coverage.sh
    python tools/mutation_trials.py --mutants 200 --seed 1
    python tools/mutation_trials.py --modules "reports/gates/*" --mutants 50

The first command stores in .coverage which tests run each line. A mutant is a copy of the package with one
operator, constant, condition, return value or argument changed. It is killed if one of the tests that run its
line, or a line that names a changed constant, fails, or takes several times its usual time.
60 tests are tried, or 240 of its package; first those that run the least other code; slow ones if --slow.
Prints the mutants that survive, some of which change nothing, and the number that were killed. Exit status 1
if fewer than 85 % were killed.
"""

from __future__ import annotations

import ast
import compileall
import importlib
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import Any

import pytest
from coverage import CoverageData
from trials import ROOT, command

MIN_KILLED = 0.85
SLACK = 5.0
"""The tests may take this many times the usual processor time, plus 5 s."""

MODULES = (
    *("reports/measurement/*", "reports/summary/*", "reports/run_files/run_tables.py", "reports/gates/*"),
    *(
        "reports/comparison/*",
        "reports/history/*",
        "reports/cache/*",
        "runs/nightly_run.py",
        "cli/nightly.py",
    ),
    *("runs/version_search.py", "adapters/versions/*", "adapters/engine_names.py", "adapters/stable_step.py"),
    *("adapters/workers/build_identity.py", "_util/platform_identity.py", "_util/file_digests.py"),
)
MOST_TESTS, MOST_OWN_TESTS = 60, 240

# always the same folder, because kernels are cached by their path
_FOLDER = Path(tempfile.gettempdir()) / "bodycheck-mutants"
_OUTPUT = _FOLDER / "output.txt"
_CACHE = _FOLDER / "cache"
_MAX_MEMORY = 8 * 2**30  # bytes, in case a mutant never ends

_OPTIONS = (
    *("-x", "-q", "-n0", "-p", "no:cacheprovider", "--hypothesis-seed=0"),
    *("--tb=short", "--assert=plain"),  # pytest's assertion rewriting would precede all imports
)
_HEAVY = (
    "hypothesis.stateful",
    "pandas",
    "playwright.sync_api",
    "rich.console",
    "scipy.interpolate",
    "scipy.sparse.linalg",
    "scipy.special",
    "bodycheck.reference_impl.truth.certification",
    "bodycheck.scenarios.reader",
)

_FORGOTTEN = (
    "bodycheck._util.compiled_cache",
    "bodycheck._util.platform_identity",
    "bodycheck._util.file_digests",
)

_OTHER: dict[type[ast.AST], tuple[Any, ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
}


@dataclass(frozen=True)
class Mutant:
    """One change of one module: the code before and after, and the whole source."""

    module: str
    line: int
    before: str
    after: str
    source: str

    def __str__(self) -> str:
        return f"bodycheck/{self.module}:{self.line}: {self.before} -> {self.after}"


def main(
    coverage: Path = ROOT / ".coverage",
    mutants: int = 200,
    seed: int = 1,
    modules: tuple[str, ...] = MODULES,
    slow: bool = False,
) -> bool:
    """Try mutants of these modules; return whether too few were killed."""
    package = ROOT / "bodycheck"
    names = sorted(path.relative_to(package).as_posix() for path in package.rglob("*.py"))
    names = [name for name in names if any(fnmatchcase(name, pattern) for pattern in modules)]
    every = [mutant for name in names for mutant in mutants_of(name)]
    random.Random(seed).shuffle(every)
    drawn = sorted(every[:mutants], key=lambda mutant: (mutant.module, mutant.line))
    print(f"{len(every)} mutants, {len(drawn)} drawn")
    tests = tests_of(drawn, coverage)
    try:
        _FOLDER.mkdir()
    except FileExistsError:
        raise SystemExit(f"{_FOLDER}: is there: trials go on, or were killed: then remove it") from None
    try:
        survived = tried(copied(_FOLDER), dict(zip(drawn, tests, strict=True)), slow)
    finally:
        shutil.rmtree(_FOLDER)
    return summed_up(drawn, survived)


def tests_of(mutants: Sequence[Mutant], coverage: Path) -> list[tuple[str, ...]]:
    """Return the tests of each mutant, those of its package first, then those that run the fewest lines."""
    data = CoverageData(str(coverage))
    data.read()
    lines = {path: data.contexts_by_lineno(path) for path in data.measured_files()}
    run = Counter(test for by_line in lines.values() for tests in by_line.values() for test in tests)
    found = []
    for mutant in mutants:
        by_line = lines.get(str(ROOT / "bodycheck" / mutant.module), {})
        own = {test for line in _lines_with(mutant) for test in by_line.get(line, ()) if test}
        own = own or {test for tests in by_line.values() for test in tests if test}
        package, _, module = mutant.module.removesuffix(".py").rpartition("/")
        of_it = {test for test in own if test.startswith(f"tests/{package}/") or f"/test_{module}" in test}
        ranked = sorted(own, key=lambda test: (test not in of_it, run[test], test))
        found.append(tuple(ranked[: max(MOST_TESTS, min(len(of_it), MOST_OWN_TESTS))]))
    return found


def _lines_with(mutant: Mutant) -> set[int]:
    """Return the line of a mutant in a function, or those in functions that name what another one assigns."""
    tree = ast.parse((ROOT / "bodycheck" / mutant.module).read_text(encoding="utf-8"))
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    if any(one.body[0].lineno <= mutant.line <= (one.end_lineno or 0) for one in functions):
        return {mutant.line}
    changed = [one for one in tree.body if one.lineno <= mutant.line <= (one.end_lineno or 0)]
    names = [node for one in changed for node in ast.walk(one) if isinstance(node, ast.Name)]
    assigned = {name.id for name in names if isinstance(name.ctx, ast.Store)}
    inside = (node for function in functions for node in ast.walk(function))
    return {node.lineno for node in inside if isinstance(node, ast.Name) and node.id in assigned}


def summed_up(judged: Sequence[Mutant], survived: Sequence[Mutant]) -> bool:
    """Print how many were killed per module and in total; return whether these are too few."""
    amounts, left = (Counter(mutant.module for mutant in some) for some in (judged, survived))
    for module, amount in amounts.items():
        print(f"{amount - left[module]:4} of {amount:4} killed  {module}")
    killed = len(judged) - len(survived)
    share = killed / len(judged) if judged else 0.0
    print(f"{killed:4} of {len(judged):4} killed in all: {100.0 * share:.1f} %")
    return share < MIN_KILLED


def copied(place: Path) -> Path:
    """Return a copy of the repository, from which everything is imported from now on."""
    left = shutil.ignore_patterns("__pycache__", ".git", ".venv", ".*_cache", ".coverage*", "_build")
    shutil.copytree(ROOT, place, symlinks=True, ignore=left, dirs_exist_ok=True)  # tests read the docs too
    # by the hash of the source, because a mutant may have the size and the time of another
    compileall.compile_dir(place / "bodycheck", quiet=1, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    os.chdir(place)
    os.environ |= {"PYTHONPATH": str(place), "BODYCHECK_CACHE_DIR": str(_CACHE)}
    sys.path.insert(0, str(place))
    # modules that no mutant changes are imported once and inherited by the processes of the trials
    for heavy in _HEAVY:
        importlib.import_module(heavy)
    for name in _FORGOTTEN:  # needed to find the kernels, but mutated themselves
        package, _, module = name.rpartition(".")
        del sys.modules[name]
        delattr(sys.modules[package], module)
    assert Path(sys.modules["bodycheck"].__file__ or "").is_relative_to(place)
    assert not any(name.startswith(("bodycheck.reports", "bodycheck.adapters")) for name in sys.modules)
    return place


def tried(place: Path, mutants: Mapping[Mutant, tuple[str, ...]], slow: bool) -> list[Mutant]:
    """Run the tests of each mutant on it; return the survivors."""
    tiers = "-m", "not nightly" if slow else "not slow and not nightly"
    survived, usual = list[Mutant](), dict[tuple[str, ...], tuple[tuple[str, ...], float]]()
    for mutant, chosen in mutants.items():
        file = place / "bodycheck" / mutant.module
        if chosen not in usual:
            usual[chosen] = passing(chosen, tiers)
        tests, usual_s = usual[chosen]
        sound = file.read_text(encoding="utf-8")
        file.write_text(mutant.source, encoding="utf-8")
        if not tests or passed(tests, SLACK * (1.0 + usual_s), *tiers):
            survived.append(mutant)
            print(f"survived  {mutant}", flush=True)
        file.write_text(sound, encoding="utf-8")
    return survived


def passing(tests: tuple[str, ...], tiers: tuple[str, str]) -> tuple[tuple[str, ...], float]:
    """Return the tests that pass in a copy without a mutant, and their processor time in s."""
    while True:
        start = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        if not tests or passed(tests, 600.0, "--maxfail=60", *tiers):
            return tests, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - start
        text = _OUTPUT.read_text()
        failed = re.findall("^(?:FAILED|ERROR) (.*?)(?: - .*)?$", text, re.MULTILINE)
        if not any(test in failed for test in tests):
            raise SystemExit(f"without a mutant they fail: {', '.join(tests)}\n{text}")
        print(f"left out  {', '.join(failed)}: fails without a mutant", flush=True)
        tests = tuple(test for test in tests if test not in failed)


def passed(tests: Sequence[str], limit_s: float, *options: str) -> bool:
    """Return whether tests pass within this processor time, in a separate process, from no stored results."""
    shutil.rmtree(_CACHE / "results", ignore_errors=True)  # they are of the code without this mutant
    trial = multiprocessing.get_context("fork").Process(target=_test, args=([*options, *tests], limit_s))
    trial.start()
    trial.join(20.0 * limit_s)  # allows for a process that waits and for a busy machine
    with suppress(ProcessLookupError):
        os.killpg(trial.pid or 0, signal.SIGKILL)  # with all its workers
    trial.join()
    return trial.exitcode == 0


def _test(words: Sequence[str], limit_s: float) -> None:
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 1))
    resource.setrlimit(resource.RLIMIT_DATA, (_MAX_MEMORY, _MAX_MEMORY))  # a browser reserves more addresses
    output = os.open(_OUTPUT, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    status = pytest.main([*_OPTIONS, *words])
    sys.exit(status not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED))


def mutants_of(module: str) -> Iterator[Mutant]:
    """Yield every mutant of a module, in the order of its source."""
    text = (ROOT / "bodycheck" / module).read_text(encoding="utf-8")
    tree = ast.parse(text)
    for parent, field, place, line in _places(tree, 1):
        held = getattr(parent, field)
        old = held if place is None else held[place]
        for new in _instead(old, field):
            if place is None:
                setattr(parent, field, new)
            else:
                setattr(parent, field, [*held[:place], *filter(None, [new]), *held[place + 1 :]])
            after = "nothing" if new is None else ast.unparse(new)
            yield Mutant(module, line, ast.unparse(old), after, ast.unparse(tree))
        setattr(parent, field, held)


def _places(node: ast.AST, line: int) -> Iterator[tuple[ast.AST, str, int | None, int]]:
    """Yield parent, field, index in the field's list and line of all code within a node."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "format_spec"):
            continue
        for place, child in enumerate(value) if isinstance(value, list) else ((None, value),):
            if not isinstance(child, ast.AST) or _says_only(node, child):
                continue
            # before Python 3.12 the parts of an f-string have no line of their own
            quoted = isinstance(node, ast.JoinedStr | ast.FormattedValue)
            at = line if quoted else getattr(child, "lineno", line)
            yield node, field, place, at
            yield from _places(child, at)


def _says_only(parent: ast.AST, child: ast.AST) -> bool:
    """Return whether a node is for readers or the type checker and changes nothing that is measured."""
    match child:
        case ast.Expr(value=ast.Constant()) | ast.Raise() | ast.Assert() | ast.Import() | ast.ImportFrom():
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.AnnAssign(annotation=ast.Name(id="TypeAlias")):
            return True
        case ast.Constant():
            return isinstance(parent, ast.JoinedStr)
        case ast.keyword(arg="strict"):
            return True
    return False


def _instead(old: Any, field: str) -> Iterator[ast.AST | None]:
    """Yield the replacements of a piece of code; None deletes it."""
    if field in ("test", "ifs") and not _has_an_opposite(old):
        yield ast.UnaryOp(ast.Not(), old)
    match old:
        case ast.Compare(left, ops, comparators):
            for place, operator in enumerate(ops):
                for other in _OTHER[type(operator)]:
                    yield ast.Compare(left, [*ops[:place], other(), *ops[place + 1 :]], comparators)
        case ast.BoolOp(op, values):
            yield from (ast.BoolOp(other(), values) for other in _OTHER[type(op)])
        case ast.BinOp(left, op, right):
            yield from (ast.BinOp(left, other(), right) for other in _OTHER.get(type(op), ()))
        case ast.AugAssign(target, op, value):
            yield from (ast.AugAssign(target, other(), value) for other in _OTHER.get(type(op), ()))
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.Return(ast.expr() as value) if ast.unparse(value) not in ("None", "False"):
            yield ast.Return(ast.Constant(None))
        case ast.Constant(bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(float(value)):
            yield ast.Constant(2.0 * value or 1.0)
        case ast.Constant(str(value)) if re.fullmatch(r"\w[\w.-]*", value):
            yield ast.Constant(f"{value}_")
        case ast.keyword(str()):
            yield None


def _has_an_opposite(test: ast.AST) -> bool:
    """Return whether a condition is already negated by another operator."""
    match test:
        case ast.UnaryOp(ast.Not()):
            return True
        case ast.Compare(ops=[ast.Eq() | ast.NotEq() | ast.In() | ast.NotIn() | ast.Is() | ast.IsNot()]):
            return True
    return False


if __name__ == "__main__":
    command(main)
