"""Runs on an executor: threads, processes or a Dask cluster."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from bodycheck._util.errors import InputError
from bodycheck.adapters.contract import Engine, Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers import case_messages
from bodycheck.adapters.workers.executors import CaseRequest, ExecutorEngines, answer_case
from bodycheck.reports.cache.disk_cache import Entry
from bodycheck.reports.cache.journal import Journal
from bodycheck.runs import cluster as dask_cluster
from bodycheck.runs.directory import run_to_folder
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import no_progress
from bodycheck.runs.runner import run
from bodycheck.runs.speed import _laps_of
from bodycheck.scenarios.library import load_scenario
from tests.helpers.dask_cluster import Loopback, loopback_cluster
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import RUN_SPECIFIC_COLUMNS, tumbling

ENGINES = ["reference:m1", "reference:rk4", "reference:exact", "mujoco:euler"]


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of a small scenario."""
    path = tmp_path_factory.mktemp("executors") / "mine.toml"
    path.write_text(tumbling())
    return path


@pytest.fixture(scope="module")
def here(scenario: Path) -> list[pd.DataFrame]:
    """Return the tables of a run without an executor."""
    return tables(run([scenario], engines=ENGINES, speed=False, fresh=True))


def tables(measured: Any) -> list[pd.DataFrame]:
    """Return the tables of a run without the columns that differ between equal runs."""
    found = [measured.results, measured.methods, measured.stability, measured.probes]
    return [table.drop(columns=RUN_SPECIFIC_COLUMNS, errors="ignore") for table in found]


def assert_same(measured: Any, here: list[pd.DataFrame]) -> None:
    """Assert that all tables are equal."""
    for table, expected in zip(tables(measured), here, strict=True):
        pd.testing.assert_frame_equal(table, expected)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", [pytest.param("threads", marks=pytest.mark.nightly), "processes"])
def test_any_executor_gives_the_tables_of_a_run(kind: str, scenario: Path, here: list[pd.DataFrame]) -> None:
    """A case is one picklable task, so threads and spawned processes give the tables of a normal run."""
    executor: Executor = (
        ThreadPoolExecutor(2)
        if kind == "threads"
        else ProcessPoolExecutor(2, mp_context=get_context("spawn"))
    )
    with executor:
        assert_same(run([scenario], engines=ENGINES, speed=False, fresh=True, executor=executor), here)


class Failing(Executor):
    """An executor whose tasks all raise an error."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Return the future of a task that raised an error."""
        del fn, args, kwargs
        future: Future[Any] = Future()
        future.set_exception(ValueError("out of reach"))
        return future


@pytest.mark.slow
def test_case_that_the_executor_fails_is_failed(scenario: Path) -> None:
    """The error of the executor is the message of the case."""
    found = run([scenario], engines=["reference:m1"], dt_s=[0.1], speed=False, fresh=True, executor=Failing())
    assert found.results["outcome"].tolist() == ["failed"]
    assert found.results["message"].tolist() == ["executor: ValueError: out of reach"]


def nested(depth: int) -> list[Any]:
    """Return lists in lists."""
    found: list[Any] = []
    for _ in range(depth):
        found = [found]
    return found


WRONG = {
    "nothing": None,
    "text": "ok",
    "a list": [{"outcome": "ok"}],
    "an object": object(),
    "a mapping of objects": {"outcome": "ok", "trajectory": object()},
    "not a number": {"outcome": "ok", "cpu_s": float("nan")},
    "nested": {"outcome": nested(100_000)},
    "keys that are no text": {(1, 2): "ok"},
    "bytes": b"{}",
}


class Answering(Executor):
    """An executor whose tasks all return one answer."""

    def __init__(self, answer: Any) -> None:
        self._answer = answer

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Return the future of the answer."""
        del fn, args, kwargs
        future: Future[Any] = Future()
        future.set_result(self._answer)
        return future


@pytest.mark.parametrize("answer", WRONG.values(), ids=WRONG)
def test_wrong_answer_of_an_executor_costs_one_case(answer: Any) -> None:
    """An answer that is no mapping of plain data fails its case, which then has no speed."""
    executor = Answering(answer)
    engines = ExecutorEngines(executor, [(Engine("reference", "1", {}), Reference().methods["m1"])])
    found = engines.ask("reference", {"do": "record", "case": {}}, 1.0)
    assert found["outcome"] == "failed"
    assert found["message"].startswith("executor: ")
    assert found["message"].isprintable()
    assert set(_laps_of(executor.submit(None))) == {"lost"}


@pytest.mark.parametrize(
    "laps",
    [
        {},
        {"own_s": 1.0, "reference_s": [1.0]},
        {"own_s": [1.0], "reference_s": ["1"]},
        {"own_s": [-1.0], "reference_s": [1.0]},
        {"own_s": [True], "reference_s": [1.0]},
        {"lost": 3},
    ],
)
def test_wrong_laps_of_an_executor_cost_one_speed(laps: Any) -> None:
    """Times are positive numbers, as from a local worker."""
    assert set(_laps_of(Answering(laps).submit(None))) == {"lost"}


@pytest.mark.parametrize(
    "address",
    ["tcp://10.0.0.1:8786", "10.0.0.1:8786", "tcp://scheduler:8786", "ws://localhost.example:1", "x"],
)
def test_cluster_elsewhere_without_tls_is_refused(address: str, expected_message: ExpectedMessage) -> None:
    """Whoever can change the messages of a cluster can run code on this machine."""
    with expected_message.raises(InputError), dask_cluster.connected(address, None, speed=False):
        pass


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:8786", "127.0.0.9:1", "tcp://localhost:1", "tcp://[::1]:1"]
)
def test_address_of_this_machine_is_recognised(address: str) -> None:
    """A cluster on this machine needs no encryption."""
    assert dask_cluster._is_loopback(address)


@pytest.mark.slow
def test_other_version_of_an_engine_on_a_worker_fails_its_cases() -> None:
    """A worker never answers for a release other than the one that the run announces."""
    case = Case(load_scenario("free-flight").scene, "m1", Setting(dt_s=0.1))
    request = {"do": "record", "case": case_messages.case_message(case)}
    with ThreadPoolExecutor(1) as thread:  # the engine ends with the thread
        answer = thread.submit(answer_case, CaseRequest("reference", "0.0.1", request, 60.0)).result()
    assert answer["outcome"] == "failed"
    assert ", but 0.0.1 in the run" in answer["message"]


class FakeTask:
    """A task of a cluster that ends when `end` is called."""

    def __init__(self, function: Any, arguments: tuple[Any, ...]) -> None:
        self.status, self._function, self._arguments = "pending", function, arguments
        self._callback: Any = None
        self.can_be_fetched = threading.Event()
        self.can_be_fetched.set()

    def add_done_callback(self, callback: Any) -> None:
        """Store the function to call at the end."""
        self._callback = callback

    def result(self) -> Any:
        """Return the result of the call once it can be fetched."""
        if not self.can_be_fetched.wait(60.0):
            raise TimeoutError
        return self._function(*self._arguments)

    def exception(self) -> Exception:
        """Return the reason why the task failed."""
        return RuntimeError("killed")

    def end(self, status: str) -> None:
        """End with this status."""
        self.status = status
        self._callback(self)


class FakeClient:
    """A client of a cluster with two workers of one thread, whose tasks end when a test calls `end`."""

    status = "running"

    def __init__(self) -> None:
        self.tasks: list[FakeTask] = []
        self.busy: dict[str, tuple[str, ...]] = {}
        self.last_seen = {"a": 1.0, "b": 1.0}
        self.workers: list[Any] = []
        self.others_allowed: list[bool] = []
        self.submitted = threading.Semaphore(0)

    def submit(
        self, function: Any, *arguments: Any, key: str, workers: Any, allow_other_workers: bool, **_: Any
    ) -> FakeTask:
        """Return a task, which is assigned to the first of the allowed workers."""
        self.busy = {(workers or ["a"])[0]: (key,)}
        self.tasks.append(FakeTask(function, arguments))
        self.workers.append(workers)
        self.others_allowed.append(allow_other_workers)
        self.submitted.release()
        return self.tasks[-1]

    def nthreads(self) -> dict[str, int]:
        """Return two workers with one thread each."""
        return {"a": 1, "b": 1}

    def processing(self) -> dict[str, tuple[str, ...]]:
        """Return the worker of the last task, unless it has ended."""
        return {} if self.tasks[-1].status == "finished" else self.busy

    def has_what(self) -> dict[str, tuple[str, ...]]:
        """Return the worker that holds the result of the last task."""
        return self.busy if self.tasks[-1].status == "finished" else {}

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        """Return when the scheduler last heard from each worker."""
        assert n_workers == -1
        return {"workers": {name: {"last_seen": seen} for name, seen in self.last_seen.items()}}

    def cancel(self, tasks: Any, **_: Any) -> None:
        """Do nothing: a task may end although it was cancelled."""


@pytest.fixture
def client() -> FakeClient:
    """Return a client of a cluster whose tasks end when a test calls `end`."""
    return FakeClient()


@pytest.fixture
def executor(client: FakeClient) -> Iterator[dask_cluster.DaskExecutor]:
    """Return the executor of that client."""
    with dask_cluster.DaskExecutor(client, "--cluster fake") as executor:
        yield executor


def waited(client: FakeClient, tasks: int = 1) -> None:
    """Wait until further tasks have been submitted."""
    for _ in range(tasks):
        assert client.submitted.acquire(timeout=60.0)


@pytest.mark.parametrize(
    "results",
    [
        *WRONG.values(),
        *([], [(1.0, 2)], [(1.0, 2, "error")], [("1", 2, None)], [(float("nan"), 2, None)]),
        [(1.0, 2, None)] * 2,
    ],
)
def test_wrong_answer_of_a_batch_costs_its_calls(
    results: Any, client: FakeClient, executor: dask_cluster.DaskExecutor
) -> None:
    """A worker of a cluster that answers something else fails the calls that it got; none waits for ever."""
    future = executor.submit(abs, -3)
    waited(client)
    client.tasks[-1].result = lambda: results  # type: ignore[method-assign]
    client.tasks[-1].end("finished")
    with pytest.raises(TypeError, match="not that of 1 calls"):
        future.result(timeout=60.0)


def fetched() -> None:
    """Wait until no result is being fetched."""
    for thread in threading.enumerate():
        if thread.name == dask_cluster.FETCHING:
            thread.join(60.0)


@pytest.fixture
def three_calls_fill_a_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a batch of three calls, however slowly they arrive."""
    monkeypatch.setattr(dask_cluster, "_LINGER_S", 3600.0)
    monkeypatch.setattr(dask_cluster, "_FIRST_CASE_S", 0.4 * dask_cluster._BATCH_S)


@pytest.mark.usefixtures("three_calls_fill_a_batch")
def test_calls_travel_in_batches(client: FakeClient, executor: dask_cluster.DaskExecutor) -> None:
    """Many short calls are sent as one task, and each receives its own result or error."""
    futures = [executor.submit(abs, argument) for argument in (-1, "text", -3)]
    waited(client)
    client.tasks[0].end("finished")
    assert futures[0].result(60.0) == 1
    assert isinstance(futures[1].exception(60.0), TypeError)
    assert futures[2].result(60.0) == 3
    assert len(client.tasks) == 1


@pytest.mark.usefixtures("three_calls_fill_a_batch")
def test_calls_of_a_failed_task_run_again_one_by_one(
    client: FakeClient, executor: dask_cluster.DaskExecutor
) -> None:
    """Only the call that fails alone fails; it does not make the other calls of its batch fail."""
    futures = [executor.submit(abs, argument) for argument in (-1, -2, -3)]
    waited(client)
    client.tasks[0].end("error")
    waited(client, 3)
    for task, status in zip(client.tasks[1:], ["finished", "error", "finished"], strict=True):
        task.end(status)
    assert [futures[0].result(60.0), futures[2].result(60.0)] == [1, 3]
    assert str(futures[1].exception(60.0)) == "killed"


@pytest.mark.slow
def test_late_task_is_sent_again_and_counts_once(
    client: FakeClient, executor: dask_cluster.DaskExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first result of two tasks for the same call counts, and the second one changes nothing."""
    monkeypatch.setattr(dask_cluster, "_LATE_S", 0.01)
    future = executor.submit(abs, -1)
    waited(client, 2)
    results: list[int] = []
    future.add_done_callback(lambda done: results.append(done.result()))
    for task in client.tasks[::-1]:
        task.end("finished")
    fetched()
    assert results == [1]


@pytest.mark.slow
def test_result_that_cannot_be_fetched_is_computed_elsewhere(
    client: FakeClient, executor: dask_cluster.DaskExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker may stop between the end of a task and the transfer of its result, which then never ends."""
    monkeypatch.setattr(dask_cluster, "_LATE_S", 0.01)
    future = executor.submit(abs, -1)
    waited(client)
    stuck = client.tasks[0]
    stuck.can_be_fetched.clear()
    stuck.end("finished")
    waited(client)
    client.tasks[1].end("finished")
    assert future.result(60.0) == 1
    assert client.workers == [None, ["b"]]
    stuck.can_be_fetched.set()
    fetched()


@pytest.mark.slow
def test_late_tasks_are_sent_again_while_calls_wait_for_room(
    client: FakeClient, executor: dask_cluster.DaskExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cluster takes four batches; if none of them ends, a fifth call must not wait for ever."""
    monkeypatch.setattr(dask_cluster, "_LATE_S", 3600.0)
    for argument in range(4):
        executor.submit(abs, -argument)
        waited(client)
    executor.submit(abs, -4)
    monkeypatch.setattr(dask_cluster, "_LATE_S", 0.01)
    waited(client)
    assert client.workers[:4] == [None] * 4
    assert client.workers[4] is not None  # a copy for certain workers


def test_timed_calls_run_on_the_named_workers_only(client: FakeClient) -> None:
    """No other worker may take them, even if all of those named are lost."""
    with dask_cluster.DaskExecutor(client, "--cluster fake", workers=["a", "b"]) as executor:
        executor.submit(abs, -1)
        waited(client)
    assert (client.workers, client.others_allowed) == ([["a", "b"]], [False])


@pytest.mark.slow
def test_silent_worker_gets_no_further_task_until_it_is_heard(
    client: FakeClient, executor: dask_cluster.DaskExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Further tasks go to other workers until the scheduler hears from the silent worker again."""
    monkeypatch.setattr(dask_cluster, "_LATE_S", 0.01)
    monkeypatch.setattr(dask_cluster, "_COUNTED_AGAIN_S", 0.0)
    executor.submit(abs, -1)
    waited(client, 2)
    client.tasks[1].end("finished")
    later = executor.submit(abs, -2)
    waited(client)
    assert client.workers == [None, ["b"], ["b"]]
    assert client.others_allowed == [False, True, True]  # all of those named may be lost
    client.tasks[2].end("finished")
    assert later.result(60.0) == 2
    client.last_seen["a"] = 2.0
    monkeypatch.setattr(dask_cluster, "_LATE_S", 3600.0)
    while executor._silent:
        time.sleep(0.01)
    executor.submit(abs, -3)
    waited(client)
    assert client.workers[3] is None


def test_calls_fail_when_the_connection_is_lost_and_later_ones_are_refused(
    client: FakeClient, executor: dask_cluster.DaskExecutor
) -> None:
    """The executor is broken, which ends the run; a failed case would stay failed when it is resumed."""
    future = executor.submit(abs, -1)
    waited(client)
    client.status = "closed"
    client.tasks[0].end("cancelled")
    lost = future.exception(60.0)
    assert isinstance(lost, BrokenExecutor)
    assert "the connection was lost" in str(lost)
    with pytest.raises(BrokenExecutor, match="the connection was lost"):
        executor.submit(abs, -2)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loopback]:
    """Return a cluster of three workers with TLS, of which only the first may time cases."""
    pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("cluster")
    with loopback_cluster(folder, [["--resources", "timing=1"], [], []]) as cluster:
        yield cluster


def requested(scenario: Path, cluster: Loopback, **others: Any) -> Request:
    """Return a request for a run on the cluster."""
    given: dict[str, Any] = {"scenarios": [str(scenario)], "engines": ENGINES, "speed": False, "fresh": True}
    tls = {"tls_ca_file": cluster.tls["ca"], "tls_cert": cluster.tls["cert"], "tls_key": cluster.tls["key"]}
    return Request(**{**given, "cluster": cluster.address, **tls, **others})


@pytest.mark.nightly
def test_cluster_gives_the_tables_of_a_run(
    cluster: Loopback, scenario: Path, here: list[pd.DataFrame], tmp_path: Path
) -> None:
    """A cluster with TLS gives the tables of a local run; a worker with the resource measures all speeds."""
    measured, _ = run_to_folder(requested(scenario, cluster, speed=True), tmp_path / "out", no_progress)
    assert_same(measured, here)
    assert measured.results["cpu_s"].gt(0.0).all()


@pytest.mark.nightly
def test_cluster_without_encryption_or_out_of_reach_is_refused(
    cluster: Loopback,
    scenario: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    expected_message: ExpectedMessage,
) -> None:
    """The run is refused in one line with status 2, and nothing is written."""
    monkeypatch.setattr(dask_cluster, "_CONNECTION_S", 1.0)
    without = replace(requested(scenario, cluster), tls_ca_file=None, tls_cert=None, tls_key=None)
    elsewhere = replace(requested(scenario, cluster), cluster="tls://127.0.0.1:1")
    for wrong in (without, elsewhere):
        with expected_message.raises(InputError):
            run_to_folder(wrong, tmp_path / "out", no_progress)
    with expected_message.raises(InputError):
        run_to_folder(replace(requested(scenario, cluster), tls_key=None), tmp_path / "out", no_progress)
    assert list(tmp_path.iterdir()) == []
    ended = run_bodycheck(tmp_path, "run", str(scenario), "--tls-key", "key.pem")
    assert ended.returncode == 2


@pytest.mark.nightly
def test_lost_workers_lose_and_double_nothing(
    cluster: Loopback,
    scenario: Path,
    here: list[pd.DataFrame],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If one worker is killed and one stops, the tables are the same and each answer is stored once."""
    monkeypatch.setattr(dask_cluster, "_LATE_S", 1.0)
    keys: list[str] = []
    append = Journal.append

    def appended(journal: Journal, entry: Entry) -> None:
        append(journal, entry)
        keys.append(entry.key)
        if len(keys) == 3 and not (tmp_path / "out").exists():
            cluster.workers[1].send_signal(signal.SIGKILL)
            cluster.workers[2].send_signal(signal.SIGSTOP)

    monkeypatch.setattr(Journal, "append", appended)
    measured, _ = run_to_folder(requested(scenario, cluster), tmp_path / "out", no_progress)
    assert_same(measured, here)
    assert len(keys) == len(set(keys)) > 3
