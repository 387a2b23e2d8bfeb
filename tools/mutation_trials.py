"""Plant small random faults in the code that measures and judges, and count how many the tests detect.

    python tools/mutation_trials.py --mutants 200 --seed 1
    python tools/mutation_trials.py --module reports/gates/verdict.py --mutants 50

A mutant is a copy of the package with one operator, constant, condition, return value or argument changed. It
is killed if one of the tests of its module fails, or takes several times its usual time. Prints the mutants
that survive and the number that were killed. Exit status 1 if fewer than 85 % were killed.
"""

from __future__ import annotations

import argparse
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
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
MIN_KILLED = 0.85
SLACK = 5.0
"""The tests may take this many times the usual processor time, plus 5 s."""

_MEASURES = ("measures", "scales", "invariants", "case")
_SPLINES = "test_energy_balance.py::test_integral_of_a_spline_is_exact_for_its_polynomials"
_GATES = tuple(f"gates/test_{name}.py" for name in ("gate_output", "gate", "gate_files", "proposals"))
_PAST = "history/test_past_runs.py"
_NIGHTLY = (
    "../test_reuse.py",
    "../test_nightly_command.py",
    "history/test_damaged_history.py",
    "../test_nightly_command.py::test_nightly_run_fails_on_a_regression",
    "../test_nightly_command.py::test_interrupted_nightly_run_is_resumed",
)
_IDENTITY = tuple(
    f"../adapters/test_identity.py::{name}"
    for name in (
        "test_identity_changes_with_each_part",
        "test_identity_ignores_what_cannot_change_results",
        "test_installed_engine_lists_its_parts",
        "test_code_loaded_later_from_elsewhere_changes_the_identity",
        "test_libraries_are_the_mapped_files_with_code",
        "test_packages_that_numba_imports_do_not_change_a_plug_in",
    )
)
_TWO_VERSIONS = "../test_versions.py::test_two_versions_are_compared_under_one_name"
TESTS: dict[str, tuple[str, ...]] = {
    **{f"reports/measurement/{name}.py": ("test_measures.py",) for name in _MEASURES},
    "reports/measurement/work.py": ("test_measures.py", _SPLINES),
    "reports/measurement/convergence.py": ("test_convergence.py", "test_limits.py"),
    "reports/measurement/limits.py": ("test_limits.py",),
    "reports/measurement/order.py": ("test_order.py", "test_convergence.py"),
    "reports/measurement/verdicts.py": ("test_verdicts.py", "test_summary.py"),
    "reports/measurement/growth.py": ("test_growth.py",),
    "reports/measurement/study.py": ("test_verdicts.py",),
    "reports/summary/worst_results.py": ("test_verdicts.py", "test_summary.py", "test_worst_results.py"),
    "reports/run_files/run_tables.py": ("test_verdicts.py", "comparison/test_change.py"),
    "reports/summary/cells.py": ("test_verdicts.py",),
    "adapters/stable_step.py": ("../adapters/test_stable_step.py", "test_measures.py"),
    **{f"reports/gates/{name}.py": _GATES for name in ("gate", "gate_output", "proposal", "verdict")},
    **{
        f"reports/comparison/{name}.py": ("comparison/test_change.py", "comparison/test_headlines.py")
        for name in ("change", "compare", "environment_diff", "headlines")
    },
    "reports/comparison/comparison_document.py": tuple(
        f"comparison/test_{name}.py" for name in ("change", "headlines", "measure_track", "overlays")
    ),
    "reports/history/levels.py": ("history/test_regression.py",),
    "reports/comparison/release_results.py": (
        "comparison/test_bisection.py",
        "comparison/test_version_text.py",
        "comparison/test_measure_track.py",
    ),
    "reports/history/step_detection.py": ("history/test_step_detection.py",),
    "reports/history/baseline.py": (
        "history/test_baseline.py",
        "history/test_damaged_history.py",
        f"{_PAST}::test_run_dated_in_the_future_is_reported_and_not_a_baseline",
        f"{_PAST}::test_damaged_past_run_is_named_and_not_a_baseline[a footer, before sums]",
        "history/test_regression.py::test_runs_of_another_machine_class_are_not_compared",
        "history/test_regression.py::test_history_without_levels_is_compared_with_its_values",
    ),
    "reports/history/archive.py": ("history/test_archive.py", "../test_nightly_command.py"),
    "reports/cache/truths.py": ("cache/test_cache.py",),
    "reports/cache/answers.py": ("cache/test_answers.py",),
    "reports/cache/journal.py": ("cache/test_journal.py",),
    "reports/cache/disk_cache.py": (
        "cache/test_journal.py",
        "cache/test_answers.py",
        "cache/test_cache.py",
        "../test_reuse.py",
    ),
    "runs/nightly_run.py": (
        "../test_nightly_run.py",
        *_NIGHTLY,
        f"{_PAST}::test_run_that_cannot_be_judged_is_stored",
        f"{_PAST}::test_internal_error_of_judging_loses_no_run",
    ),
    "cli/nightly.py": (
        "../test_console.py::test_every_command_is_in_a_named_group_of_the_help",
        *_NIGHTLY,
        "../test_nightly_command.py::test_history_is_listed_queried_and_pruned",
    ),
    "adapters/workers/build_identity.py": ("../adapters/test_identity.py", *_IDENTITY),
    "_util/platform_identity.py": (
        "../reference_impl/test_installed_libraries.py",
        "../adapters/test_identity.py",
        *_IDENTITY,
    ),
    "_util/file_digests.py": ("../reference_impl/test_file_digests.py",),
    **dict.fromkeys(
        ("adapters/engine_names.py", "adapters/versions/uv.py"),
        ("../adapters/test_pinned_versions.py", "../test_versions.py", _TWO_VERSIONS),
    ),
    "adapters/versions/environments.py": (
        "../adapters/test_pinned_versions.py",
        "../adapters/test_optional_engines.py",
        "../adapters/test_optional_engines.py::test_optional_engines_run_only_if_named",
        "../test_versions.py",
        _TWO_VERSIONS,
    ),
    "examine/probes/examination.py": (
        "test_fingerprint.py",
        "test_fingerprint.py::test_an_unknown_map_is_described_by_its_leading_error",
    ),
    "runs/version_search.py": (
        "../test_versions.py",
        "../test_versions.py::test_every_release_is_run_on_request",
        _TWO_VERSIONS,
        "../audit/test_audit.py::test_release_in_which_an_audit_changed_is_named",
    ),
    "reports/history/regression.py": ("history/test_regression.py", "history/test_step_detection.py"),
}
"""Module -> the tests under tests/reports that belong to it, fastest first.

A file stands for its tests that are not slow; a test named by itself may be slow, if it runs at each push.
"""

ONLY = {
    "reports/measurement/case.py": {"measured_by", "_horizon"},
    "reports/measurement/study.py": {"stability_row", "_search"},
    "reports/summary/cells.py": {
        "faults_of",
        "summary_cell",
        "summary_cells",
    },
}
"""For these modules only these functions are changed."""

EQUIVALENT: dict[tuple[str, str, str], str] = {
    (
        "adapters/workers/build_identity.py",
        '("address", ctypes.c_void_p),',
        "'address' -> 'address_'",
    ): "a field that is not read",
    (
        "reports/measurement/convergence.py",
        "for number in range(_MIN_LIMIT_POINTS if rounded else len(known), len(known) + 1):",
        "1 -> 2",
    ): "the last limit twice",
    (
        "reports/comparison/change.py",
        "if new > old:",
        "new > old -> new >= old",
    ): "equal values are no change",
    (
        "reports/comparison/change.py",
        'status: Status = "worse" if low > slack else "improved"',
        "low > slack -> low >= slack",
    ): "a lower quartile that is the slack itself is not reported",
    (
        "reports/comparison/change.py",
        'return "moved" if before == after else "improved" if after > before else "worse"',
        "after > before -> after >= before",
    ): "there the two are not equal",
    (
        "reports/measurement/invariants.py",
        "low, high = (abs(moments[i + 1] - moments[i]) <= _EQUAL * moments[2] for i in (0, 1))",
        "abs(moments[i + 1] - moments[i]) <= _EQUAL * moments[2]"
        " -> abs(moments[i + 1] - moments[i]) < _EQUAL * moments[2]",
    ): "a difference of two moments is never this very multiple of the third",
    (
        "reports/history/regression.py",
        'status: Status = "worse" if size > 0.0 else "improved"',
        "size > 0.0 -> size >= 0.0",
    ): "a detected step has a size",
    (
        "reports/comparison/release_results.py",
        "_FEWEST_DIGITS, _ALL_DIGITS = 3, 17",
        "17 -> 18",
    ): "17 digits distinguish all doubles",
    (
        "reports/measurement/growth.py",
        'return "exponential" if misfit_in_time * _EXPONENTIAL_GAIN < misfit else None',
        "misfit_in_time * _EXPONENTIAL_GAIN < misfit -> misfit_in_time * _EXPONENTIAL_GAIN <= misfit",
    ): "of two fits' residuals neither is this very multiple of the other",
    (
        "reports/measurement/growth.py",
        'return "sqrt" if low <= exponent <= high and late > _ROOT_LATE and irregular else None',
        "low <= exponent <= high -> low <= exponent < high",
    ): "an exponent that is fitted is never the very double of an edge",
    (
        "reports/measurement/growth.py",
        "irregular = slopes[0] < _RAMP and slopes[-1] > _FLAT and float(np.max(slopes)) < _STEEPEST",
        "slopes[-1] > _FLAT -> slopes[-1] >= _FLAT",
    ): "a slope between logarithms is never the very double of an edge",
    (
        "reports/comparison/comparison_document.py",
        'size = one.size if one.kind == "accuracy" else 0.0',
        "0.0 -> 1.0",
    ): "only sizes of one kind are compared",
    (
        "reports/comparison/comparison_document.py",
        'word = "slow" if change.decades > 0.0 else "fast"',
        "change.decades > 0.0 -> change.decades >= 0.0",
    ): "a speed that is the same is no change",
    (
        "reports/gates/proposal.py",
        'yield BoundChange(index, "upper", gate.upper, new, largest, loosens=new > gate.upper)',
        "new > gate.upper -> new >= gate.upper",
    ): "a bound that stays the same is not proposed",
    (
        "reports/measurement/growth.py",
        "irregular = slopes[0] < _RAMP and slopes[-1] > _FLAT and float(np.max(slopes)) < _STEEPEST",
        "float(np.max(slopes)) < _STEEPEST -> float(np.max(slopes)) <= _STEEPEST",
    ): "a slope between logarithms is never the very double of an edge",
    (
        "reports/measurement/growth.py",
        "if slopes[-1] < _MIN_EXPONENTIAL or not np.all(np.diff(slopes[1:]) > 0.0):",
        "np.diff(slopes[1:]) > 0.0 -> np.diff(slopes[1:]) >= 0.0",
    ): "two slopes between logarithms that are not 0 are never the very same double",
    (
        "reports/measurement/convergence.py",
        "too_fine = max(listed) * finer / interval_s > _SPAN * (1.0 + 1e-9)",
        "max(listed) * finer / interval_s > _SPAN * (1.0 + 1e-09) -> "
        "max(listed) * finer / interval_s >= _SPAN * (1.0 + 1e-09)",
    ): "the billionth is slack for round-off: no ratio of steps asked for is this very double",
    (
        "reports/measurement/work.py",
        "if any(abs(t[k] - end) > 1e-9 * scene.sample_interval_s "
        "for k, end in zip(indices, ends, strict=True)):",
        "abs(t[k] - end) > 1e-09 * scene.sample_interval_s -> "
        "abs(t[k] - end) >= 1e-09 * scene.sample_interval_s",
    ): "the billionth is slack for round-off: no switch is this very double next to a sample",
    (
        "adapters/versions/uv.py",
        "done = subprocess.run(command, capture_output=True, text=True, check=False)",
        "check=False -> nothing",
    ): "the default, written out for readers",
    **{
        (
            "adapters/workers/build_identity.py",
            f'("{name}", ctypes.{kind}),',
            f"'{name}' -> '{name}_'",
        ): "of the system's record only `adds` is read"
        for name, kind in (("headers", "c_void_p"), ("header_count", "c_uint16"))
    },
    (
        "reports/cache/answers.py",
        'return self._motion(engine_pool, engine, case, "record", kind="sentinel", cached=False)',
        "'sentinel' -> 'sentinel_'",
    ): "another name that no other request has",
    (
        "reports/cache/answers.py",
        '_Result = TypeVar("_Result", Answer, StableStep)',
        "'_Result' -> '_Result_'",
    ): "the name that a type variable prints",
}
"""Module, line of its source, `before -> after` -> why no test can tell that mutant from the code."""

# always the same folder, because kernels are cached by their path
_FOLDER = Path(tempfile.gettempdir()) / "bodycheck-mutants"
_OUTPUT = _FOLDER / "output.txt"
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
    """One change of one module: the code of a line before and after, and the whole source."""

    module: str
    line: int
    text: str
    before: str
    after: str
    source: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Return the name of the mutant in EQUIVALENT."""
        return self.module, self.text, f"{self.before} -> {self.after}"

    def __str__(self) -> str:
        return f"bodycheck/{self.module}:{self.line}: {self.before} -> {self.after}"


def main() -> int:
    """Run the tests on the requested mutants; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--mutants", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--module",
        action="append",
        choices=sorted(TESTS),
        help="the module to change; repeatable [default: all]",
    )
    requested = parser.parse_args()
    every = [mutant for module in TESTS for mutant in mutants_of(module)]
    if stale := EQUIVALENT.keys() - {mutant.key for mutant in every}:
        raise SystemExit("\n".join(f"EQUIVALENT has what is no mutant: {key}" for key in sorted(stale)))
    chosen = [mutant for mutant in every if mutant.module in (requested.module or TESTS)]
    random.Random(requested.seed).shuffle(chosen)
    drawn = chosen[: requested.mutants]
    judged = [mutant for mutant in drawn if mutant.key not in EQUIVALENT]
    print(f"{len(chosen)} mutants, {len(drawn)} drawn, {len(drawn) - len(judged)} of them equivalent")
    try:
        _FOLDER.mkdir()
    except FileExistsError:
        raise SystemExit(f"{_FOLDER}: is there: trials go on, or were killed: then remove it") from None
    try:
        survived = tried(copied(_FOLDER), sorted(judged, key=lambda mutant: mutant.module))
    finally:
        shutil.rmtree(_FOLDER)
    return summed_up(judged, survived)


def summed_up(judged: Sequence[Mutant], survived: Sequence[Mutant]) -> int:
    """Print how many were killed per module and in total; return the exit status."""
    amounts, left = (Counter(mutant.module for mutant in some) for some in (judged, survived))
    for module, amount in amounts.items():
        print(f"{amount - left[module]:4} of {amount:4} killed  {module}")
    killed = len(judged) - len(survived)
    share = killed / len(judged) if judged else 0.0
    print(f"{killed:4} of {len(judged):4} killed in all: {100.0 * share:.1f} %")
    return 0 if share >= MIN_KILLED else 1


def copied(place: Path) -> Path:
    """Return a copy of the package and its tests, from which everything is imported from now on."""
    for name in ("bodycheck", "tests"):
        shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, place)
    # by the hash of the source, because a mutant may have the size and the time of another
    compileall.compile_dir(place / "bodycheck", quiet=1, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    os.chdir(place)
    os.environ["PYTHONPATH"] = str(place)
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


def tried(place: Path, mutants: Sequence[Mutant]) -> list[Mutant]:
    """Run the tests on each mutant, module by module; return the survivors."""
    survived, usual_s = list[Mutant](), dict[tuple[str, ...], float]()
    for mutant in mutants:
        tests, file = TESTS[mutant.module], place / "bodycheck" / mutant.module
        if tests not in usual_s:
            usual_s[tests] = usual(tests)
        sound = file.read_text(encoding="utf-8")
        file.write_text(mutant.source, encoding="utf-8")
        if passed(tests, SLACK * (1.0 + usual_s[tests])):
            survived.append(mutant)
            print(f"survived  {mutant}", flush=True)
        file.write_text(sound, encoding="utf-8")
    return survived


def usual(tests: Sequence[str]) -> float:
    """Return the processor time in s that the tests take without a mutant; they must pass."""
    for _ in range(2):  # the first pass compiles
        start = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        if not passed(tests, 600.0):
            raise SystemExit(f"without a mutant they fail: {', '.join(tests)}\n{_OUTPUT.read_text()}")
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - start


def passed(tests: Sequence[str], limit_s: float) -> bool:
    """Return whether tests pass within this processor time, in a separate process."""
    trial = multiprocessing.get_context("fork").Process(target=_test, args=(tests, limit_s))
    trial.start()
    trial.join(20.0 * limit_s)  # allows for a process that waits and for a busy machine
    with suppress(ProcessLookupError):
        os.killpg(trial.pid or 0, signal.SIGKILL)  # with all its workers
    trial.join()
    return trial.exitcode == 0


def _test(tests: Sequence[str], limit_s: float) -> None:
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 1))
    resource.setrlimit(resource.RLIMIT_AS, (_MAX_MEMORY, _MAX_MEMORY))
    output = os.open(_OUTPUT, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    paths = [os.path.normpath(f"tests/reports/{test}") for test in tests]
    files, named = ([path for path in paths if ("::" in path) is single] for single in (False, True))
    failed = pytest.main([*_OPTIONS, "-m", "not slow", *files])
    sys.exit(failed or (pytest.main([*_OPTIONS, *named]) if named else 0))


def mutants_of(module: str) -> Iterator[Mutant]:
    """Yield every mutant of a module, in the order of its source."""
    text = (ROOT / "bodycheck" / module).read_text(encoding="utf-8")
    tree, lines = ast.parse(text), text.splitlines()
    for parent, field, place, line in _places(tree, 1):
        if module in ONLY and not any(begin <= line <= end for begin, end in _spans(tree, ONLY[module])):
            continue
        held = getattr(parent, field)
        old = held if place is None else held[place]
        for new in _instead(old, field):
            if place is None:
                setattr(parent, field, new)
            else:
                setattr(parent, field, [*held[:place], *filter(None, [new]), *held[place + 1 :]])
            after = "nothing" if new is None else ast.unparse(new)
            yield Mutant(module, line, lines[line - 1].strip(), ast.unparse(old), after, ast.unparse(tree))
        setattr(parent, field, held)


def _spans(tree: ast.Module, names: set[str]) -> list[tuple[int, int]]:
    """Return the first and the last line of each function."""
    found = [one for one in tree.body if isinstance(one, ast.FunctionDef) and one.name in names]
    return [(one.lineno, one.end_lineno or one.lineno) for one in found]


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
    sys.exit(main())
