"""Run cases on a Dask cluster: batches of at least half a second, and no case lost or counted twice."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import version
from ipaddress import ip_address
from typing import Any, ParamSpec, TypeVar
from urllib.parse import urlsplit

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.formatting import count, names
from bodycheck.adapters.workers.executors import run_batch
from bodycheck.reports.history.baseline import machine_class
from bodycheck.runs.manifest import machine
from bodycheck.runs.request import Timing

TIMING = "timing"
"""The resource that a worker declares if nothing else runs on its machine while it times cases."""

_BATCH_S = 0.5
_LINGER_S = 0.02  # a batch that is not full waits this long for another case
_QUEUED = 2  # batches per thread of the cluster, so that none is idle while an answer is under way
_FIRST_CASE_S = 0.005
_CONNECTION_S = 30.0
_COUNTED_AGAIN_S = 2.0
_LATE, _LATE_S = 5.0, 10.0  # a batch is late after this many times its expected time, and at least so long
_MAX_COPIES = 3
FETCHING = "bodycheck-fetch"
"""Name of the threads that fetch results."""

_P = ParamSpec("_P")
_T = TypeVar("_T")


@dataclass(frozen=True)
class TlsFiles:
    """PEM files: the certificate of the authority, and the certificate and key of this client."""

    ca_file: str
    cert: str
    key: str


@dataclass(frozen=True)
class Cluster:
    """The executors of a cluster: for cases, and for timing them if that was requested."""

    executor: Executor
    timing: Timing | None


@contextmanager
def connected(
    address: str, tls: TlsFiles | None, *, speed: bool, insecure: bool = False
) -> Iterator[Cluster]:
    """Connect to the Dask scheduler at an address like tls://host:8786.

    insecure: whether the connection to another machine may be without TLS. Raises InputError where it may
    not, it cannot be reached, has no workers, they have another version of bodycheck, or speeds are
    requested and no worker declares the resource `timing`; UnavailableError without Dask.
    """
    if not (insecure or tls is not None or address.startswith("tls://") or _is_loopback(address)):
        raise InputError(
            f"--cluster {address}: without TLS anybody on the network can run code here; give --tls-ca-file, "
            "--tls-cert and --tls-key, or --insecure if you trust the network"
        )
    client = _client(address, tls)
    try:
        option = f"--cluster {address}"
        _check_workers(client, option)
        timed_by = _timing_workers(client, option) if speed else None
        with DaskExecutor(client, option) as executor:
            if timed_by is None:
                yield Cluster(executor, None)
            else:
                resources, facts = {TIMING: 1.0}, timed_by[next(iter(timed_by))]
                with DaskExecutor(client, option, resources=resources, workers=timed_by) as timing:
                    yield Cluster(executor, Timing(timing, facts))
    finally:
        client.close(timeout=_CONNECTION_S)


def _is_loopback(address: str) -> bool:
    """Whether an address like tcp://127.0.0.1:8786 is on this machine."""
    host = urlsplit(address if "://" in address else f"tcp://{address}").hostname or ""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _client(address: str, tls: TlsFiles | None) -> Any:
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise UnavailableError("--cluster needs Dask: pip install 'bodycheck[cluster]'") from None
    try:
        security = None
        if tls is not None:
            security = distributed.Security(
                tls_ca_file=tls.ca_file,
                tls_client_cert=tls.cert,
                tls_client_key=tls.key,
                require_encryption=True,
            )
        return distributed.Client(
            address, security=security, timeout=_CONNECTION_S, set_as_default=False, name="bodycheck"
        )
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"--cluster {address}: cannot be reached: {' '.join(str(error).split())}") from None


def _check_workers(client: Any, option: str) -> None:
    """Raise InputError unless there are workers, all of which have this version of bodycheck."""
    try:
        client.wait_for_workers(1, timeout=_CONNECTION_S)
    except TimeoutError:
        raise InputError(f"{option}: has no workers") from None
    found = client.run(version, "bodycheck", on_error="return")
    wrong = {address: one for address, one in found.items() if one != version("bodycheck")}
    if wrong:
        faults = (
            f"{address} has {one if isinstance(one, str) else repr(one)}" for address, one in wrong.items()
        )
        raise InputError(f"{option}: workers need bodycheck {version('bodycheck')}: {names(list(faults))}")


def _timing_workers(client: Any, option: str) -> dict[str, Mapping[str, Any]]:
    """Return address -> machine of the workers that time cases: of the most frequent class."""
    workers = client.scheduler_info(n_workers=-1)["workers"]
    declared = [address for address, facts in workers.items() if facts["resources"].get(TIMING)]
    if not declared:
        raise InputError(
            f"{option}: no worker declares the resource {TIMING}; start one on a machine of its own with "
            f"--resources '{TIMING}=1', or add --no-speed"
        )
    machines: dict[str, dict[str, Any]] = client.run(machine, workers=declared)
    for worker, facts in machines.items():
        if not isinstance(facts, dict) or machine().keys() - facts.keys():
            raise InputError(f"{option}: {worker} does not state the facts of its machine")
    classes = Counter(machine_class(facts) for facts in machines.values())
    chosen = max(sorted(classes), key=lambda name: classes[name])
    return {address: facts for address, facts in machines.items() if machine_class(facts) == chosen}


@dataclass(eq=False)
class _Item:
    """One call, and the future of its result."""

    argument: Any
    future: Future[Any]
    expected_s: float


@dataclass(eq=False)
class _Batch:
    """Calls that are sent together; copies: the tasks that do them, by key, of which the first counts."""

    function: Callable[[Any], Any]
    items: list[_Item]
    sent_s: float = field(default_factory=time.monotonic)
    copies: dict[str, Any] = field(default_factory=dict)

    @property
    def expected_s(self) -> float:
        return sum(item.expected_s for item in self.items)


class DaskExecutor(Executor):
    """Calls of functions with one argument, on a Dask cluster, in batches.

    The result of each call is set once, by the first task that returns it. Dask runs the tasks of a lost
    worker again; a task of which nothing is heard for long is sent to another worker too, and the first
    worker gets no further ones until the scheduler hears from it. An argument may have `kind` and `steps`:
    calls of one kind are expected to take a time proportional to the steps.
    resources, workers: required of, or the only ones for, every task.
    """

    def __init__(
        self,
        client: Any,
        option: str,
        *,
        resources: Mapping[str, float] | None = None,
        workers: Collection[str] | None = None,
    ) -> None:
        self._client, self._option = client, option
        self._resources, self._workers = resources, workers
        self._pending: dict[Callable[[Any], Any], deque[_Item]] = {}
        self._batches: set[_Batch] = set()
        self._step_s: dict[Any, float] = {}
        self._changed = threading.Condition()
        self._arrived_s, self._closed, self._lost = 0.0, False, ""
        self._counted_s, self._threads = -math.inf, {"": 1}
        self._silent: dict[str, float] = {}
        self._thread = threading.Thread(target=self._serve, name="bodycheck-cluster", daemon=True)
        self._thread.start()

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Return the future of fn(argument); raises BrokenExecutor once the cluster was lost."""
        (argument,) = args
        future: Future[_T] = Future()
        with self._changed:
            if self._lost:
                raise BrokenExecutor(self._lost)
            if self._closed or kwargs:
                raise RuntimeError(
                    "the executor was closed" if self._closed else "takes one positional argument"
                )
            steps = self._step_s.get(getattr(argument, "kind", None))
            expected_s = _FIRST_CASE_S if steps is None else steps * getattr(argument, "steps", 1.0)
            call: Any = fn
            self._pending.setdefault(call, deque()).append(_Item(argument, future, expected_s))
            self._arrived_s = time.monotonic()
            self._changed.notify_all()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:  # noqa: ARG002 - never waits
        """Cancel what is under way."""
        with self._changed:
            if self._closed:
                return
            self._closed = True
            copies = [task for batch in self._batches for task in batch.copies.values()]
            self._changed.notify_all()
        self._thread.join()
        if copies and self._client.status == "running":
            self._client.cancel(copies, force=True)

    def _serve(self) -> None:
        """Send batches until the executor is closed."""
        while True:
            with self._changed:
                if self._closed:
                    return
                self._changed.wait(self._pause_s())
                batches = [] if self._closed else self._full_batches()
            try:
                self._count_threads()
                for batch in batches:
                    self._send(batch, None)
                self._rescue()
            except Exception as error:  # noqa: BLE001 - whatever fails here, nobody may wait for ever
                self._break(f"{type(error).__name__}: {error}")
                return

    def _pause_s(self) -> float:
        if any(self._pending.values()) and self._has_room:
            return max(0.0, self._arrived_s + _LINGER_S - time.monotonic()) + 1e-3
        return 1.0

    @property
    def _slots(self) -> int:
        return max(1, sum(self._threads.values()))

    @property
    def _has_room(self) -> bool:
        """Whether the cluster takes another batch."""
        return len(self._batches) < _QUEUED * self._slots

    def _full_batches(self) -> list[_Batch]:
        """Take calls for as many batches as the cluster has room for, each of half a second or more.

        A smaller batch is sent once no further call has arrived for a moment.
        """
        batches: list[_Batch] = []
        complete = time.monotonic() - self._arrived_s >= _LINGER_S
        for function, items in self._pending.items():
            while items and self._has_room:
                left_s = sum(item.expected_s for item in items)
                if left_s < _BATCH_S and not complete:
                    break
                target_s, size_s = max(_BATCH_S, left_s / (_QUEUED * self._slots)), 0.0
                batch = _Batch(function, [])
                while items and size_s < target_s:
                    item = items.popleft()
                    if item.future.set_running_or_notify_cancel():
                        batch.items.append(item)
                        size_s += item.expected_s
                if batch.items:
                    self._batches.add(batch)
                    batches.append(batch)
        return batches

    def _send(self, batch: _Batch, workers: Collection[str] | None) -> None:
        """Submit a batch; workers: the only ones for it [default: those of the executor]."""
        key = f"bodycheck-{secrets.token_hex(8)}"
        batch.sent_s = time.monotonic()
        allowed = self._allowed(workers or self._workers)
        task = self._client.submit(
            run_batch,
            batch.function,
            [item.argument for item in batch.items],
            key=key,
            pure=False,
            resources=self._resources,
            workers=allowed,
            # for any case, others may do it once all of those allowed are lost
            allow_other_workers=allowed is not None and self._workers is None,
        )
        with self._changed:
            batch.copies[key] = task

        def ended(done: Any) -> None:
            """Fetch the results in a thread of their own: those of a stopped worker may never arrive."""
            arguments = batch, key, done
            threading.Thread(target=self._ended, args=arguments, name=FETCHING, daemon=True).start()

        task.add_done_callback(ended)

    def _allowed(self, workers: Collection[str] | None) -> list[str] | None:
        """Return the workers for a task, None for any: not those from which nothing is heard, if possible."""
        responding = set(self._threads if workers is None else workers) - self._silent.keys()
        if responding and self._silent:
            return sorted(responding)
        return None if workers is None else list(workers)

    def _ended(self, batch: _Batch, key: str, task: Any) -> None:
        """Set the results of a task, or run its calls again one by one."""
        found = _results_of(task, len(batch.items))
        failed = isinstance(found, Exception)
        with self._changed:
            batch.copies.pop(key, None)
            if self._closed or batch not in self._batches or (failed and batch.copies):
                return  # another copy was faster, or is under way
        if not isinstance(found, Exception):
            for item, (seconds, result, error) in zip(batch.items, found, strict=True):
                self._update_cost(item, seconds)
                self._set(item, result, error)
        elif self._client.status != "running":
            self._break(f"the connection was lost: {found}")
        elif len(batch.items) == 1:
            self._set(batch.items[0], None, found)
        else:
            alone = [_Batch(batch.function, [item]) for item in batch.items]
            with self._changed:
                self._batches.update(alone)
            for one in alone:
                self._send(one, None)
        self._forget(batch)

    def _update_cost(self, item: _Item, seconds: float) -> None:
        """Remember how long a step takes; a case that was slowed down, as the first one is, counts little."""
        kind = getattr(item.argument, "kind", None)
        step_s = seconds / getattr(item.argument, "steps", 1.0)
        self._step_s[kind] = min(step_s, 1.5 * self._step_s.get(kind, math.inf))

    def _set(self, item: _Item, result: Any, error: Exception | None) -> None:
        with self._changed:
            if item.future.done():
                return
            if error is None:
                item.future.set_result(result)
            else:
                item.future.set_exception(error)

    def _forget(self, batch: _Batch) -> None:
        """Remove a batch whose results are known, and cancel its other copies."""
        with self._changed:
            self._batches.discard(batch)
            others = list(batch.copies.values())
            batch.copies.clear()
            self._changed.notify_all()
        if others:
            self._client.cancel(others, force=True)

    def _rescue(self) -> None:
        """Send batches of which nothing was heard for long to other workers too, unless calls can be sent."""
        now = time.monotonic()
        with self._changed:
            if any(self._pending.values()) and self._has_room:
                return
            overdue = [
                batch
                for batch in self._batches
                if now - batch.sent_s > max(_LATE_S, _LATE * batch.expected_s)
                and len(batch.copies) < _MAX_COPIES
            ]
        if not overdue:
            return
        seen_s = self._last_seen()
        keys_of = [*self._client.processing().items(), *self._client.has_what().items()]
        for batch in overdue:
            busy = {address for address, keys in keys_of if batch.copies.keys() & set(keys)}
            self._silent |= {address: seen_s[address] for address in busy & seen_s.keys()}
            if others := set(self._workers or self._threads) - busy:
                self._send(batch, others)
            else:
                batch.sent_s = now

    def _last_seen(self) -> dict[str, float]:
        """Return when the scheduler last heard from each worker, in s of its clock."""
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        return {address: facts["last_seen"] for address, facts in workers.items()}

    def _count_threads(self) -> None:
        now = time.monotonic()
        if now - self._counted_s > _COUNTED_AGAIN_S:
            self._counted_s = now
            if self._client.status in ("closed", "closing"):
                raise ConnectionError("the connection was lost")
            found = self._client.nthreads()
            self._threads = {
                address: 1 if self._resources else threads
                for address, threads in found.items()
                if self._workers is None or address in self._workers
            }
            if self._silent:
                seen_s = self._last_seen()
                silent = self._silent.items()
                self._silent = {address: last for address, last in silent if seen_s.get(address) == last}

    def _break(self, why: str) -> None:
        """Fail all calls, also later ones: the cluster does not answer any more."""
        with self._changed:
            items = [item for batch in self._batches for item in batch.items]
            items += [item for waiting in self._pending.values() for item in waiting]
            self._closed = True
            self._lost = f"{self._option}: {why}; {count(len(items), 'case')} under way"
            self._changed.notify_all()
        for item in items:
            self._set(item, None, BrokenExecutor(self._lost))


def _results_of(task: Any, count: int) -> list[tuple[float, Any, Exception | None]] | Exception:
    """Return what `run_batch` returned for so many calls, or why the task has no such result."""
    try:
        if task.status == "finished":
            results: list[tuple[float, Any, Exception | None]] = task.result()
            if isinstance(results, list) and len(results) == count and all(map(_is_result, results)):
                return results
            return TypeError(f"a worker's answer is not that of {count} calls")
        fault: Exception = task.exception() if task.status == "error" else RuntimeError(f"task {task.status}")
    except Exception as error:  # noqa: BLE001 - the connection may be lost while the result is fetched
        fault = error
    return fault


def _is_result(found: Any) -> bool:
    """Whether this is the time, the result and the error of a call."""
    if not isinstance(found, tuple) or len(found) != 3:
        return False
    seconds, _, error = found
    return (
        isinstance(seconds, float)
        and 0.0 <= seconds < math.inf
        and (error is None or isinstance(error, Exception))
    )
