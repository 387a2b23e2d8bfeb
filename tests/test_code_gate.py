"""Nothing but the user's own words starts a program or imports a module."""

from __future__ import annotations

import ast
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import bodycheck
from bodycheck.adapters.registry import registered
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import tumbling

PACKAGE = Path(bodycheck.__file__).parent

CONSTANT, OWN, INSTALLED, ASKED = (
    "the name is a constant of the source",
    "the name is one of this package's modules",
    "an installed package registers it, and pip has asked the user",
    "the gate was asked",
)
PLACES = {
    ("__init__.py", "__getattr__", "importlib.import_module"): OWN,
    ("adapters/importers/__init__.py", "importer", "importlib.import_module"): OWN,
    ("adapters/optional/between_steps.py", "OnRequest.__init__", "importlib.import_module"): CONSTANT,
    ("adapters/optional/ode.py", "Ode.__init__", "ctypes.CDLL"): INSTALLED,
    ("adapters/registry.py", "_import", "EntryPoint.load"): INSTALLED,
    ("adapters/registry.py", "_import", "importlib.import_module"): OWN,
    ("adapters/registry.py", "stated_by", "importlib.import_module"): OWN,
    ("adapters/tree_contract.py", "tree_model_of", "importlib.import_module"): "the text of an adapter",
    ("adapters/versions/environments.py", "_npm_install", "subprocess.run"): CONSTANT,
    ("adapters/versions/uv.py", "_pip_config", "subprocess.run"): CONSTANT,
    ("adapters/versions/uv.py", "_watched", "subprocess.DEVNULL"): CONSTANT,
    ("adapters/versions/uv.py", "_watched", "subprocess.Popen"): CONSTANT,
    ("adapters/versions/uv.py", "uv", "subprocess.run"): CONSTANT,
    ("adapters/versions/uv.py", "uv_program", "importlib.import_module"): CONSTANT,
    ("adapters/workers/build_identity.py", "_iterate_libraries", "ctypes.CDLL"): "of this process itself",
    ("adapters/workers/launcher.py", "die_with_the_run", "ctypes.CDLL"): "of this process itself",
    ("adapters/workers/launcher.py", "main", "os.execvp"): "the program of worker_process.py",
    ("adapters/workers/worker.py", "_handed_over", "pickle.loads"): "the user called register_adapter",
    ("adapters/workers/worker.py", "_import", "importlib.import_module"): "the user called register_adapter",
    ("adapters/workers/worker.py", "_import", "importlib.util.spec_from_file_location"): "the same module",
    ("adapters/workers/worker.py", "_import", "exec_module"): "the same module",
    ("adapters/workers/worker.py", "_run_script", "compile"): "the user's own script",
    ("adapters/workers/worker.py", "_run_script", "exec"): "the user's own script",
    ("adapters/workers/worker_bootstrap.py", "main", "exec_module"): OWN,
    ("adapters/workers/worker_bootstrap.py", "main", "importlib.util.spec_from_file_location"): OWN,
    ("adapters/workers/worker_bootstrap.py", "main", "runpy.run_module"): OWN,
    ("adapters/workers/worker_process.py", "WorkerProcess.__init__", "subprocess.Popen"): ASKED,
    ("cli/rooms/__init__.py", "rooms", "importlib.import_module"): OWN,
    ("reference_impl/integrators/__init__.py", "", "importlib.import_module"): OWN,
    ("reference_impl/kernels/cache_files.py", "_content", "pickle.loads"): "the user's cache folder",
    ("reference_impl/loads/__init__.py", "load_kinds", "importlib.import_module"): OWN,
    ("reference_impl/trees/joint_kinds/__init__.py", "joint_kinds", "importlib.import_module"): OWN,
    ("reference_impl/precompile.py", "_second_process", "subprocess.Popen"): CONSTANT,
    ("runs/cluster.py", "_client", "importlib.import_module"): CONSTANT,
    ("runs/doctor.py", "_javascript", "subprocess.run"): CONSTANT,
    ("runs/manifest.py", "_git", "subprocess.run"): CONSTANT,
    ("scenarios/model_files/usd.py", "asked", "subprocess.run"): CONSTANT,
    ("scenarios/user_functions.py", "user_function", "importlib.import_module"): ASKED,
}
"""(file, function, what starts or imports) -> why no text of a stranger gets there."""

MODULES = {
    *["code", "marshal", "multiprocessing", "pickle", "pty", "runpy", "shelve", "subprocess", "webbrowser"]
}
_HOW = ["l", "le", "lp", "lpe", "v", "ve", "vp", "vpe"]
STARTERS = {
    *("importlib.import_module", "importlib.__import__", "importlib.util.spec_from_file_location"),
    *("ctypes.CDLL", "ctypes.PyDLL", "ctypes.cdll", "concurrent.futures.ProcessPoolExecutor"),
    *("asyncio.create_subprocess_exec", "asyncio.create_subprocess_shell", "os.system", "os.popen"),
    *("os.startfile", "os.fork", "os.forkpty", "os.posix_spawn", "os.posix_spawnp"),
    *(f"os.exec{how}" for how in _HOW),
    *(f"os.spawn{how}" for how in _HOW),
}
BUILT_IN = {"exec", "eval", "compile", "__import__"}
DATA = {"subprocess.PIPE", "subprocess.TimeoutExpired", "subprocess.SubprocessError", "pickle.dumps"}


def _places(file: str, text: str) -> Iterator[tuple[str, str, str]]:
    """Yield (file, function, name) of everything in a source that can start a program or import a module."""
    tree = ast.parse(text)
    names: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for one in node.names:
                top = one.name.partition(".")[0]
                names[one.asname or top] = one.name if one.asname else top
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= {one.asname or one.name: f"{node.module}.{one.name}" for one in node.names}

    def visit(node: ast.AST, function: tuple[str, ...]) -> Iterator[tuple[str, str, str]]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            for part in ast.iter_child_nodes(node):
                yield from visit(part, (*function, node.name))
            return
        if isinstance(node, ast.Attribute | ast.Name):
            root, dot, rest = ast.unparse(node).partition(".")
            name = names.get(root, root) + dot + rest
            if root not in names and name in BUILT_IN:
                yield file, ".".join(function), name
            elif name in STARTERS or (name.partition(".")[0] in MODULES and "." in name and name not in DATA):
                yield file, ".".join(function), name
                return
            elif isinstance(node, ast.Attribute) and node.attr == "exec_module":
                yield file, ".".join(function), node.attr
        loads = isinstance(node, ast.Call) and not node.args and ast.unparse(node.func).endswith(".load")
        if loads and "entry_points" in names:
            yield file, ".".join(function), "EntryPoint.load"
        for part in ast.iter_child_nodes(node):
            yield from visit(part, function)

    yield from visit(tree, ())


@pytest.mark.slow
def test_every_place_that_starts_or_imports_is_listed() -> None:
    """A new place fails this test until PLACES states why no text of a stranger gets there."""
    sources = {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in PACKAGE.rglob("*.py")}
    found = {place for file, text in sources.items() for place in _places(file, text)}
    assert found == set(PLACES)


@pytest.mark.parametrize(
    "text",
    [
        "import subprocess\ndef f(): subprocess.run(['x'])",
        "from subprocess import Popen as start\nstart(['x'])",
        "import os\nclass A:\n    def f(self): return os.system",
        "import importlib as i\ni.import_module('x')",
        "from importlib import import_module\nfind = import_module",
        "from importlib.metadata import entry_points\ndef f(p): return p.load()",
        "def f(spec, module): spec.loader.exec_module(module)",
        "eval('1')",
        "import pickle\npickle.load(file)",
        "from multiprocessing import Process\nProcess(target=print)",
    ],
)
def test_place_beside_the_gate_is_found(text: str) -> None:
    """Each way to start a program or to import a module is recognised, also under another name."""
    assert list(_places("new.py", text))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a working directory with a scenario; remove the engines that the test registered."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(tumbling())
    with registered():
        yield tmp_path


START = "cmd:/bin/sh -c 'touch RAN'"
GATE = f"""[[gate]]
scenario = "*"
engine = {json.dumps(START)}
measure = "energy_drift"
upper = 1.0
reason = "a bound"
"""
MODULE = """
import pathlib
pathlib.Path("RAN").touch()
def load(*motion): return [0, 0, 0], [0, 0, 0]
step = load
"""
CALLABLE = '[[forcing]]\nkind = "callable"\nfunction = "hostile_loads:load"\n'


def _gates(folder: Path) -> list[str]:
    (folder / "gates.toml").write_text(GATE)
    return ["gate", "mine.toml", "--gates", "gates.toml"]


def _gate_of_a_short_name(folder: Path) -> list[str]:
    (folder / "gates.toml").write_text(GATE.replace(json.dumps(START), '"short"'))
    (folder / "engines.toml").write_text("[engines.short]\ncommand = ['/bin/sh', '-c', 'touch RAN']\n")
    return ["gate", "mine.toml", "--gates", "gates.toml"]


def _engines_file(folder: Path) -> list[str]:
    _gate_of_a_short_name(folder)
    return ["run", "mine.toml", "--engines", "engines.toml", "--engine", "short"]


def _scenario(folder: Path) -> list[str]:
    (folder / "mine.toml").write_text(tumbling() + CALLABLE)
    return ["run", "mine.toml", "--engine", "reference:rk4"]


def _request(folder: Path, **settings: object) -> list[str]:
    """Write the folder of an interrupted run whose request has these settings."""
    (folder / "out.partial").mkdir()
    request = {"scenarios": ["mine.toml"], "engines": ["reference:rk4"], "speed": False, **settings}
    description = {"run_id": "x", "created": "2026-01-01T00:00:00+00:00", "request": request}
    (folder / "out.partial/request.json").write_text(json.dumps(description, indent=2))
    return ["run", "--resume", "out"]


def _request_with_a_program(folder: Path) -> list[str]:
    return _request(folder, engines=[START])


def _request_with_a_module(folder: Path) -> list[str]:
    return _request(folder, engines=["hostile_loads:step"], allow_code=True)


def _request_with_a_function(folder: Path) -> list[str]:
    (folder / "mine.toml").write_text(tumbling() + CALLABLE)
    return _request(folder, allow_code=True)


def _request_with_a_cluster(folder: Path) -> list[str]:
    return _request(folder, cluster="tls://127.0.0.1:9")


def _style(folder: Path) -> list[str]:
    (folder / "style").write_text("font.size: 9\ntext.usetex: True\n")
    return [
        "plot",
        "stored",
        "--figure",
        "order",
        "--scenario",
        "free",
        "--svg",
        "new.svg",
        "--style",
        "style",
    ]


def _stored_program(folder: Path) -> list[str]:
    """Put a program in the place of an engine into a stored run."""
    for path in (folder / "stored").rglob("*"):
        if path.suffix == ".json":
            path.write_text(path.read_text().replace('"failing"', json.dumps(START)))
        elif path.suffix == ".csv":
            path.write_text(path.read_text().replace(",failing,", f",{START},"))
    return ["advise", "--run", "stored", "--error", "1e-13", "--search", "free"]


def _stored_function(folder: Path) -> list[str]:
    """Put a function into a scenario of a stored run."""
    path = folder / "stored/manifest.json"
    manifest = json.loads(path.read_text())
    manifest["scenarios"]["free"]["forcing"] = [{"kind": "callable", "function": "hostile_loads:load"}]
    path.write_text(json.dumps(manifest, indent=1))
    return ["explain", "stored"]


CASES: dict[str, Callable[[Path], list[str]]] = {
    "a gate's program": _gates,
    "a gate's short name": _gate_of_a_short_name,
    "the file of engines": _engines_file,
    "a scenario's function": _scenario,
    "a stored request's program": _request_with_a_program,
    "a stored request's module": _request_with_a_module,
    "a stored request's permission": _request_with_a_function,
    "a stored request's cluster": _request_with_a_cluster,
    "a style's program": _style,
    "a stored run's program": _stored_program,
    "a stored run's function": _stored_function,
}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("case", CASES)
def test_data_starts_nothing_without_permission(
    case: str, folder: Path, stored_run: Path, expected_message: ExpectedMessage
) -> None:
    """The message names the file, its line and --allow-code; nothing was started, imported or written."""
    (folder / "hostile_loads.py").write_text(MODULE)
    shutil.copytree(stored_run, folder / "stored")
    words = CASES[case](folder)
    before = sorted(path.name for path in folder.iterdir())
    done = run_bodycheck(folder, *words)
    assert not (folder / "RAN").exists()
    assert sorted(path.name for path in folder.iterdir()) == before
    assert done.returncode in (1, 2)
    expected_message((done.stderr if done.returncode == 2 else done.stdout).strip())
