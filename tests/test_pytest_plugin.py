"""The pytest plugin in a user's tests: fixtures, marker, options and summary, with and without xdist."""

from __future__ import annotations

import importlib
import json
import re
import shlex
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from types import SimpleNamespace

import pytest

from bodycheck.reports.run_files.run_reader import read_tables
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import tumbling

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[1]
MODULE = "bodycheck.pytest_plugin"
# an installation that is older than the entry point does not have it yet
INSTALLED = any(point.value == MODULE for point in entry_points(group="pytest11"))
PLUGIN = () if INSTALLED else ("-p", MODULE)
PLUGINS = () if INSTALLED else (importlib.import_module(MODULE),)

SCENARIO = tumbling(steps_s=[0.05, 0.025])

RK4 = """
from dataclasses import replace

import numpy as np
import pytest


def rate(q, omega, inertia):
    w, v = q[0], q[1:]
    q_rate = 0.5 * np.array([-v @ omega, *(w * omega + np.cross(v, omega))])
    return q_rate, np.linalg.solve(inertia, np.cross(inertia @ omega, omega))


def rk4(state, dt):
    def f(q, omega):
        return rate(q, omega, state.body.inertia)

    q, w = state.quaternion, state.omega_body
    a = f(q, w)
    b = f(q + dt / 2 * a[0], w + dt / 2 * a[1])
    c = f(q + dt / 2 * b[0], w + dt / 2 * b[1])
    d = f(q + dt * c[0], w + dt * c[1])
    q, w = (y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4) for y, k1, k2, k3, k4 in zip((q, w), a, b, c, d))
    return replace(state, quaternion=q, omega_body=w)
"""


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Import all that a run imports: pytester resets modules after a session, and numpy loads only once."""
    from numba.core.registry import cpu_target

    from bodycheck.pytest_plugin.fixtures import Bench

    cpu_target.target_context.refresh()  # numba imports modules when it loads its first kernel
    scenario = tmp_path_factory.mktemp("imported") / "mine.toml"
    scenario.write_text(SCENARIO)
    steps = [0.1, 0.05, 0.025, 0.0125]
    kept = scenario.with_name("kept")  # rendering a report imports further modules
    Bench({}, lambda _: None, "", kept).step(lambda state, _: state, scenario, dt_s=steps)


@pytest.fixture
def inner(pytester: pytest.Pytester, imported: None, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """Return a user's folder with two scenarios, and a wide terminal."""
    del imported
    monkeypatch.setenv("COLUMNS", "200")
    pytester.makefile(".toml", mine=SCENARIO, other=SCENARIO.replace('"mine"', '"other"'))
    # hypothesis would be imported again at the end of every inner session, and rewriting would warn of
    # modules that an outer session with --assert=plain has imported
    options = "--strict-markers --assert=plain -p no:cacheprovider -p no:hypothesispytest"
    pytester.makeini(f"[pytest]\nfilterwarnings = error\naddopts = {options}\n")
    return pytester


def run(inner: pytest.Pytester, *words: str) -> pytest.RunResult:
    """Run pytest in the user's folder, in this process, and return the result."""
    return inner.runpytest_inprocess(*words, plugins=PLUGINS)


def test_plugin_is_an_entry_point() -> None:
    """The project's entry point names the module with the hooks and the fixtures."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["pytest11"] == {"bodycheck": MODULE}
    plugin = importlib.import_module(MODULE)
    assert hasattr(plugin, "pytest_addoption")
    assert hasattr(plugin, "bodycheck_gate")


def test_summary_is_as_wide_as_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A check that needs more room goes on in indented lines; a path stays whole."""
    lines = ["passed mine reference:rk4: orientation_error_rad <= 1e-5: 1 case", f"report /{60 * 'a'}"]
    report = SimpleNamespace(when="call", user_properties=[("bodycheck", line) for line in lines])
    shown: list[str] = []
    reporter = SimpleNamespace(
        stats={"passed": [report]},
        section=shown.append,
        write_line=lambda text: shown.extend(text.split("\n")),
    )
    monkeypatch.setenv("COLUMNS", "50")
    importlib.import_module(MODULE).pytest_terminal_summary(reporter)
    assert shown == [
        "bodycheck",
        "passed mine reference:rk4: orientation_error_rad",
        "    <= 1e-5: 1 case",
        "report",
        f"    /{60 * 'a'}",
    ]


@pytest.mark.slow
def test_plugin_is_inert_until_a_fixture_is_used(inner: pytest.Pytester) -> None:
    """A session without the fixtures imports only the plugin module, and nothing expensive."""
    inner.makepyfile(
        """
        import sys

        def test_other():
            ours = [name for name in sys.modules if name.startswith("bodycheck")]
            assert ours == ["bodycheck", "bodycheck.pytest_plugin"]
            assert not {"numpy", "numba", "pandas", "pydantic", "mujoco", "rich"} & set(sys.modules)
        """
    )
    done = inner.runpytest_subprocess(*PLUGIN, "-p", "no:hypothesispytest", "-p", "no:xdist")
    done.assert_outcomes(passed=1)
    assert "= bodycheck =" not in done.stdout.str()


@pytest.mark.slow
def test_engine_is_run_and_compared_with_bounds(inner: pytest.Pytester) -> None:
    """A test passes if its bound is met; otherwise it shows value, bound, distance and command."""
    inner.makepyfile(
        """
        import pytest

        @pytest.fixture
        def found(bodycheck):
            return bodycheck.run("mine.toml", engine="reference", method="rk4", dt_s=0.05)

        def test_good(found):
            found.check("orientation_error_rad", lower=1e-12, upper=1e-5)
            found.check("outcome", equals="ok")
            assert 0.0 < found["energy_drift"] < 1e-5
            assert list(found.results["dt_s"]) == [0.05]

        def test_bad(found):
            found.check("orientation_error_rad", upper=1e-12)

        def test_unmeasured(found):
            found.check("cpu_s", upper=1e9)

        def test_unmeasured_value(found):
            assert found["orthogonality_error"] < 1.0

        def test_wrong(found):
            found.check("orientation_error", upper=1e-12)
        """
    )
    done = run(inner)
    done.assert_outcomes(passed=1, failed=4)
    done.stdout.fnmatch_lines(
        [
            "E*AssertionError: mine reference:rk4: orientation_error_rad <= 1e-12: 1 of 1 case failed; *",
            "E*reproduce: bodycheck run mine.toml --engine reference:rk4 --dt 0.05",
            "E*: cpu_s was not measured",
            "E*AssertionError: mine reference:rk4 dt 0.05 s: orthogonality_error was not measured",
            "E*InputError: check('orientation_error').measure: unknown measure 'orientation_error'*",
            "*= bodycheck =*",
            "passed mine reference:rk4: orientation_error_rad >= 1e-12 and <= 1e-5: 1 case; worst *",
            "measured mine reference:rk4 dt 0.05 s: energy_drift *",
            "failed mine reference:rk4: orientation_error_rad <= 1e-12: *",
        ]
    )


@pytest.mark.nightly
def test_step_function_is_measured_like_an_engine(inner: pytest.Pytester) -> None:
    """A user's RK4 has order 4 and converges; without its gyroscopic term it does not."""
    inner.makepyfile(
        RK4
        + """
STEPS = [0.1, 0.05, 0.025, 0.0125]


def lost(state, dt):
    return replace(rk4(state, dt), omega_body=state.omega_body)


def test_right(bodycheck):
    found = bodycheck.step(rk4, "mine.toml", dt_s=STEPS)
    found.check("order.orientation_error_rad", lower=3.9, upper=4.2)
    found.check("orientation_error_rad", upper=1e-5)


def test_lost(bodycheck):
    bodycheck.step(lost, "mine.toml", dt_s=STEPS).check("angular_momentum_drift", upper=1e-2)


def test_lost_in_what_is_right(bodycheck):
    bodycheck.step(lost, "mine.toml", dt_s=STEPS).check("quaternion_norm_error", upper=1.0)
"""
    )
    done = run(inner)
    done.assert_outcomes(passed=2, failed=1)
    passed = [line for line in done.outlines if line.startswith("passed mine step:")]
    assert ["; but " in line for line in passed] == ["step:lost" in line for line in passed]
    done.stdout.fnmatch_lines(
        [
            "E*mine step:lost: angular_momentum_drift <= 0.01: 4 of 4 cases failed*",
            "E*mine | step:lost | dt 0.1 s | * | angular_momentum_drift <= 0.01 | * decades beyond",
            "E*diagnosis: the gyroscopic term omega x I omega is missing*",
            "E*reproduce: pytest test_step_function_is_measured_like_an_engine.py::test_lost",
            "E*explain: pytest --bodycheck-report DIR keeps the run*",
        ]
    )


@pytest.mark.slow
def test_a_failed_order_states_its_cause(inner: pytest.Pytester) -> None:
    """The run asks for no order of a user's function, so it is diagnosed where a check of it fails."""
    inner.makepyfile(
        RK4.replace(
            "c = f(q + dt / 2 * b[0], w + dt / 2 * b[1])", "c = f(q + dt / 2 * a[0], w + dt / 2 * a[1])"
        )
        + """
def test_order(bodycheck):
    steps = [0.1, 0.05, 0.025, 0.0125]
    bodycheck.step(rk4, "mine.toml", dt_s=steps).check("order.orientation_error_rad", lower=3.9)
"""
    )
    done = run(inner)
    done.assert_outcomes(failed=1)
    cause = "the third stage starts with the slope of the first one (explains all of the error)"
    done.stdout.fnmatch_lines([f"E*diagnosis: {cause}"])


@pytest.mark.slow
def test_runs_are_kept_with_their_reports(inner: pytest.Pytester) -> None:
    """A failed order lists its errors and the path of the report; the stored run names the test to repeat."""
    inner.makepyfile(
        RK4
        + """
def euler(state, dt):
    q, w = state.quaternion, state.omega_body
    q_rate, angular_acceleration = rate(q, w, state.body.inertia)
    return replace(state, quaternion=q + dt * q_rate, omega_body=w + dt * angular_acceleration)


def test_order(bodycheck):
    found = bodycheck.step(euler, "mine.toml", dt_s=[0.1, 0.05, 0.02, 0.01])
    found.check("order.orientation_error_rad", lower=3.9)
"""
    )
    done = run(inner, "--bodycheck-report", "kept")
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(
        [
            "E*order.orientation_error_rad >= 3.9*",
            "E*dt 0.1 s: 0.*",
            "E*dt 0.05 s: 0.*, order *",
            "E*dt 0.02 s: 0.*, order *",
            "E*dt 0.01 s: 0.*, order *",
            "E*report: *kept*report.html",
            "report *kept*report.html",
        ]
    )
    (report,) = inner.path.glob("kept/*/*/report.html")
    first = re.search('<h1 class="tint-bad">Failed check: (.*)</h1>', report.read_text(encoding="utf-8"))
    assert first is not None
    assert "order.orientation_error_rad &gt;= 3.9: 1 of 1 case failed" in first[1]
    again = run_bodycheck(inner.path, "report", str(report.parent), "--html", "again.html")
    assert again.returncode == 0, again.stderr
    assert first[0] in (inner.path / "again.html").read_text(encoding="utf-8")
    (command,) = re.findall("^E +explain: bodycheck (.*)", done.stdout.str(), re.MULTILINE)
    explained = run_bodycheck(inner.path, *shlex.split(command), "--json")
    (case,) = json.loads(explained.stdout)
    assert "--case" not in command
    assert (case["scenario"], case["method"], case["wrong"]) == ("mine", "step:euler", [])
    assert "No findings in" not in report.read_text(encoding="utf-8")
    tables = read_tables(report.parent)
    assert set(tables.results["reproduce"]) == {"pytest test_runs_are_kept_with_their_reports.py::test_order"}
    assert list(tables.results["dt_s"]) == [0.1, 0.05, 0.02, 0.01]


@pytest.mark.slow
def test_step_function_gets_time_body_and_state(inner: pytest.Pytester) -> None:
    """The step function gets times k dt and arrays of the documented shapes; modifying them has no effect."""
    inner.makepyfile(
        """
        from dataclasses import replace

        def test_state(bodycheck):
            seen = []

            def step(state, dt):
                seen.append((state.t_s, dt, state.body.mass, state.body.inertia.shape, state.rotation.shape))
                position = state.position.copy()
                state.position[:] = 7.0
                return replace(state, position=position)

            found = bodycheck.step(step, "mine.toml", dt_s=0.05)
            own = [call for call in seen if call[1] == 0.05]  # the probes have steps of their own
            assert [t for t, *_ in own] == [k * 0.05 for k in range(20)]
            assert {tuple(told) for _, *told in own} == {(0.05, 1.0, (3, 3), (3, 3))}
            assert found["position_error_abs"] == 0.0
        """
    )
    run(inner).assert_outcomes(passed=1)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return 1 / 0", "ZeroDivisionError: division by zero"),
        ("return None", "TypeError: step must return a state, as dataclasses.replace does, not NoneType"),
        ("return replace(state, omega_body=np.zeros(4))", "return omega_body of shape (3,), not (4,)"),
        (
            "return replace(state, omega_body=state.omega_body + 1j)",
            "return real numbers as omega_body, not complex128",
        ),
        ("return replace(state, quaternion=list('abcd'))", "return real numbers as quaternion, not <U1"),
        (
            "return replace(state, quaternion=np.full(4, np.nan))",
            "quaternion is not finite from t = 0.1 s on",
        ),
    ],
)
def test_failing_step_function_fails_its_test(inner: pytest.Pytester, body: str, message: str) -> None:
    """The message describes the error; an exception also has its own traceback."""
    inner.makepyfile(
        f"""
        from dataclasses import replace
        import numpy as np

        def step(state, dt):
            {body}

        def test_it(bodycheck):
            bodycheck.step(step, "mine.toml", dt_s=0.1).check("energy_drift", upper=1e9)
        """
    )
    done = run(inner)
    done.assert_outcomes(failed=1)
    assert f": {'unstable' if 'finite' in message else 'failed'}: " in done.stdout.str()
    assert message in done.stdout.str()
    assert (">           " + body in done.stdout.str() or ">       " + body in done.stdout.str()) == (
        "ZeroDivision" in message
    )


@pytest.mark.slow
def test_step_function_does_not_run_a_body_with_a_pivot(inner: pytest.Pytester) -> None:
    """It gets no force of the pivot, so even a correct function would not follow the truth."""
    inner.makepyfile(
        """
        def test_it(bodycheck):
            assert bodycheck.step(lambda state, dt: state, "heavy-top", dt_s=0.01)["outcome"] == "unsupported"
        """
    )
    run(inner).assert_outcomes(passed=1)


@pytest.mark.nightly
def test_adapter_instance_is_registered_for_its_test_only(inner: pytest.Pytester) -> None:
    """An adapter instance is run like an engine, and its name is unknown after the run."""
    inner.makepyfile(
        """
        import pytest
        from bodycheck.adapters.reference import Reference
        from bodycheck.adapters.registry import engine_names

        class Mine(Reference):
            name = "my-engine"

        def test_it(bodycheck):
            found = bodycheck.run("mine.toml", engine=Mine(), method="m1", dt_s=0.05)
            assert found["outcome"] == "ok"
            assert "my-engine" not in engine_names()

        def test_none(bodycheck):
            with pytest.raises(ValueError, match="is neither an adapter nor the name of an engine"):
                bodycheck.run("mine.toml", engine=len, dt_s=0.05)
            with pytest.raises(ValueError, match="engine= is required, in the call or in the marker"):
                bodycheck.run("mine.toml", dt_s=0.05)
        """
    )
    run(inner).assert_outcomes(passed=2)


def error_of(done: pytest.RunResult) -> str:
    """Return the error line of a failed collection."""
    (after,) = (number for number, line in enumerate(done.outlines) if " ERROR collecting " in line)
    return done.outlines[after + 1]


MARKED = """
import pytest

@pytest.mark.bodycheck(dt_s=0.05)
def test_open(bodycheck):
    bodycheck.run().check("energy_drift", upper=1e-2)

@pytest.mark.bodycheck(scenario="mine.toml", engine="reference", method="m3", dt_s=0.05)
def test_said(bodycheck):
    bodycheck.run().check("energy_drift", upper=1e-2)

def test_other():
    pass
"""


@pytest.mark.nightly
def test_options_complete_the_marker(inner: pytest.Pytester) -> None:
    """Two scenarios and two methods give four tests, the marker takes precedence, and -m selects them."""
    inner.makepyfile(MARKED)
    suite = ("--bodycheck-suite", "mine.toml,other.toml")
    options = (*suite, "--bodycheck-engines", "reference:m1,reference:m2")
    listed = run(inner, *options, "--collect-only", "-q").stdout.str()
    names = re.findall(r"::test_open\[(.*?)\]", listed)
    assert names == [f"{s}.toml-reference-{m}" for s in ("mine", "other") for m in ("m1", "m2")]
    assert "::test_said\n" in listed
    done = run(inner, *options, "-k", "other.toml-reference-m2 or test_said")
    done.assert_outcomes(passed=2, deselected=4)
    done.stdout.fnmatch_lines(["passed other reference:m2: *", "passed mine reference:m3: *"])
    run(inner, "-m", "not bodycheck").assert_outcomes(passed=1, deselected=2)


def test_markers_of_module_class_and_function_are_combined(inner: pytest.Pytester) -> None:
    """The closest one takes precedence for each argument, also over the options."""
    inner.makepyfile(
        """
        import pytest

        pytestmark = pytest.mark.bodycheck(scenario="mine.toml", engine="mujoco", dt_s=0.1)

        @pytest.mark.bodycheck(engine="reference", method="m1")
        class TestReference:
            def test_class(self, bodycheck):
                assert bodycheck.defaults == {
                    "scenario": "mine.toml", "engine": "reference", "method": "m1", "dt_s": 0.1
                }

            @pytest.mark.bodycheck(method="m3")
            @pytest.mark.bodycheck(dt_s=0.05)
            def test_function(self, bodycheck):
                assert bodycheck.defaults == {
                    "scenario": "mine.toml", "engine": "reference", "method": "m3", "dt_s": 0.05
                }
        """
    )
    run(inner, "--bodycheck-engines", "mujoco:euler").assert_outcomes(passed=2)


@pytest.mark.slow
def test_marked_method_runs_on_each_engine_of_the_option(inner: pytest.Pytester) -> None:
    """The method of the marker takes precedence over those of the option."""
    inner.makepyfile(
        """
        import pytest

        @pytest.mark.bodycheck(method="rk4")
        def test_it(bodycheck):
            assert bodycheck.defaults["engine"] in ("mujoco", "reference")
            assert bodycheck.defaults["method"] == "rk4"
        """
    )
    options = ("--bodycheck-engines", "mujoco:euler,reference:m1,reference:m2")
    run(inner, *options).assert_outcomes(passed=2)
    listed = run(inner, *options, "--collect-only", "-q").stdout.str()
    assert re.findall(r"::test_it\[(.*?)\]", listed) == ["mujoco", "reference"]


@pytest.mark.parametrize(
    ("marker", "options"),
    [
        ("speed=1", ()),
        ("'mine.toml'", ()),
        ("dt_s=0.1", ("--bodycheck-engines", "havok")),
        ("dt_s=0.1", ("--bodycheck-suite", "nope")),
    ],
)
def test_wrong_marker_or_option_stops_the_session(
    inner: pytest.Pytester, marker: str, options: tuple[str, ...], expected_message: ExpectedMessage
) -> None:
    """One line without a traceback describes the error, and no test passes."""
    inner.makepyfile(
        f"import pytest\n\n@pytest.mark.bodycheck({marker})\ndef test_it(bodycheck):\n    pass\n"
    )
    done = run(inner, *options)
    assert done.ret != 0
    expected_message(error_of(done))
    assert not any(word in done.stdout.str() + done.stderr.str() for word in ("Traceback", "pluggy/"))
    done.assert_outcomes(errors=1)


def test_marked_test_without_engine_does_not_pass(inner: pytest.Pytester) -> None:
    """Without options there is nothing to run, and the message states what is missing."""
    inner.makepyfile(MARKED)
    done = run(inner, "-k", "test_open")
    done.assert_outcomes(failed=1)
    assert "bodycheck.run: scenario= is required, in the call or in the marker" in done.stdout.str()


GATES = """
[[gate]]
engine = "reference"
method = "m1"
measure = "energy_drift"
upper = 1e-2
reason = "loose"
[[gate]]
engine = "reference"
method = "m1"
measure = "energy_drift"
upper = 1e-9
reason = "too tight"
[[gate]]
engine = "nothing"
measure = "energy_drift"
upper = 1e-2
reason = "nothing has this name"
"""
USING_GATES = "def test_gates(bodycheck_gate):\n    bodycheck_gate.check()\n"


@pytest.mark.nightly
def test_each_gate_of_a_file_is_a_test(inner: pytest.Pytester) -> None:
    """A gate that holds passes, a gate that is violated fails, and so does a gate that measured nothing."""
    inner.makefile(".toml", gates=GATES)
    inner.makepyfile(USING_GATES)
    done = run(inner, "--bodycheck-gates", "gates.toml", "--bodycheck-suite", "mine.toml")
    done.assert_outcomes(passed=1, failed=2)
    done.stdout.fnmatch_lines(
        [
            "passed * reference:m1: energy_drift <= 0.01: * cases; worst *",
            "nothing * nothing:*: energy_drift*",
        ]
    )


STARTED = """
[[gate]]
engine = 'cmd:/bin/sh -c "touch RAN"'
measure = "energy_drift"
upper = 1e-2
reason = "starts a program"
"""


@pytest.mark.slow
def test_program_of_a_gate_starts_only_if_allowed(
    inner: pytest.Pytester, expected_message: ExpectedMessage
) -> None:
    """The file of gates may name programs only with --bodycheck-allow-code."""
    inner.makefile(".toml", gates=STARTED)
    inner.makepyfile(USING_GATES)
    words = ("--bodycheck-gates", "gates.toml", "--bodycheck-suite", "mine.toml")
    expected_message(error_of(run(inner, *words)), inner.path)
    assert not (inner.path / "RAN").exists()
    run(inner, *words, "--bodycheck-allow-code")
    assert (inner.path / "RAN").exists()


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--bodycheck-gates", "mine.toml"),
        ("--bodycheck-gates", "no.toml"),
    ],
)
def test_gates_without_a_valid_file_stop_the_session(
    inner: pytest.Pytester, options: tuple[str, ...], expected_message: ExpectedMessage
) -> None:
    """A missing file must not pass, because nothing would be checked."""
    inner.makepyfile(USING_GATES)
    done = run(inner, *options)
    assert done.ret != 0
    expected_message(error_of(done))
    assert "pluggy/" not in done.stdout.str()


STEPPED = """

@pytest.mark.parametrize("upper", [1e-2, 1e-3, 0.0])
def test_it(bodycheck, upper):
    bodycheck.step(rk4, "mine.toml", dt_s=0.1).check("energy_drift", upper=upper)
"""


@pytest.mark.nightly
def test_plugin_works_under_xdist(inner: pytest.Pytester) -> None:
    """Two workers give the outcomes of one process, and the summary has the lines of both."""
    inner.makepyfile(test_steps=RK4 + STEPPED)
    done = inner.runpytest_subprocess(*PLUGIN, "-n", "2")
    done.assert_outcomes(passed=2, failed=1)
    summary = done.stdout.str().partition("= bodycheck =")[2]
    lines = [
        line for line in summary.splitlines() if line.startswith(("passed mine step:rk4:", "failed mine"))
    ]
    assert sorted(line.split()[0] for line in lines) == ["failed", "passed", "passed"]
