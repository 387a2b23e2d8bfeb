from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

import bodycheck
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import registered
from bodycheck.reference_impl.precompile import compile_kernels
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.render import progress
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.scenarios.library import load_scenarios
from tests.helpers.collection_order import pytest_collection_modifyitems as pytest_collection_modifyitems
from tests.helpers.collection_order import pytest_configure as pytest_configure
from tests.helpers.collection_order import pytest_sessionfinish as pytest_sessionfinish
from tests.helpers.collection_order import pytest_terminal_summary as pytest_terminal_summary
from tests.helpers.collection_order import pytest_testnodedown as pytest_testnodedown
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.failing_engine import Failing
from tests.helpers.nightly_runs import store_nightly_runs, unchanged
from tests.helpers.shared_folder import shared_folder

# Bytecode is written even if the environment disables it: the tests start about a hundred processes, each of
# which would compile our modules again, and pytest rewrites every assertion of these files before it starts.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# readline, which pytest imports, exports the width of the terminal, to which commands would wrap their lines
os.environ.pop("COLUMNS", None)
os.unsetenv("COLUMNS")
sys.dont_write_bytecode = False

# the lines of a log depend on how busy a machine is; the test of these lines sets its own interval
progress._MAX_SILENCE_S = 1e6

FREE = """
name = "free"
summary = "a start that is made a unit quaternion, and would move by an ulp if it were made one again"
duration_s = 1.0
samples = 11
[body]
mass_kg = 1.0
inertia_kg_m2 = [1.0, 2.0, 2.5]
[initial]
quaternion = [0.6, 0.8000000001, 3e-5, 0.0]
omega_body_rad_s = [0.3, 1.0, -0.2]
"""
FORCED = """
name = "forced, and a mesh"
duration_s = 1.0
samples = 11
steps_s = [0.02, 0.01]
[body]
mesh = "part.obj"
density_kg_m3 = 600.0
link_offset_m = [0.1, 0.0, 0.0]
[initial]
omega_body_rad_s = [0.3, 1.0, -0.2]
[[forcing]]
kind = "torque"
axes = "world"
value_n_m = [0.1, 0.2, -0.1]
[[forcing]]
kind = "gravity"
acceleration_m_s2 = [0.0, 0.0, -9.81]
"""
SHAPE = """
name = "shape"
duration_s = 1.0
samples = 11
steps_s = [0.02, 0.01]
[body]
shape = "torus"
size_m = [0.7, 0.21]
density_kg_m3 = 333.3
[initial]
omega_world_rad_s = [0.3, 1.0, -0.2]
[[sweep]]
key = "source"
values = ["1"]
"""
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 2\nf 2 4 3\nf 1 3 4\n"  # inside-out


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that writes expected_messages.toml."""
    parser.addoption("--update-messages", action="store_true", help="write the messages that tests expect")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels once if all tests run, because two workers would compile the same kernels twice."""
    config = session.config
    runs_all = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not config.option.collectonly
    if runs_all and "PYTEST_XDIST_WORKER" not in os.environ:
        scenes = [scenario.scene for _, scenario in load_scenarios(["standard"])]
        methods = [method.name for method in Reference().methods.values() if method.control != "none"]
        compile_kernels(scenes, methods, unsolved=[])


@pytest.fixture
def expected_message(request: pytest.FixtureRequest) -> ExpectedMessage:
    """Return an object that compares a message with the one in expected_messages.toml for this test."""
    return ExpectedMessage(request)


@pytest.fixture(scope="session")
def stored_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of a mesh, a shape and a tensor; its methods work or fail, with speeds."""
    return shared_folder(tmp_path_factory, "stored", store_run) / "run"


@pytest.fixture(scope="session")
def stored_history(stored_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a history of two nightly runs, which are the stored run."""

    def store(folder: Path) -> None:
        run = read_run(stored_run, allow_code=False, cache=Cache.default())
        store_nightly_runs(run, folder / "nights", [unchanged, unchanged])

    return shared_folder(tmp_path_factory, "history", store) / "nights"


def store_run(folder: Path) -> None:
    """Run the three scenarios and write the run into the folder."""
    files = {"free.toml": FREE, "forced.toml": FORCED, "shape.toml": SHAPE, "part.obj": TETRAHEDRON}
    for name, text in files.items():
        (folder / name).write_text(text)
    with registered(Failing()):
        engines = ["reference:m1", "reference:rk4", "reference:exact", "reference:taylor", "failing"]
        scenarios = [folder / name for name in files if name.endswith(".toml")]
        run = bodycheck.run(scenarios, engines=engines, jobs=1)
    bodycheck.write_run(run, folder / "run")
    (folder / "part.obj").unlink()  # no command that reads a stored run may need the mesh file
