"""What a run measures, and how: each option is declared once, as a field of `Request`.

The parameters of `bodycheck run` and `bodycheck nightly`, those of `bodycheck.run`, the file from which an
interrupted run is continued, the entry `request` of a manifest, and what `merge` compares follow from it.
"""

# annotations are evaluated: the options are derived from them
import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import KW_ONLY, Field, dataclass, field, fields
from functools import wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

from bodycheck._util.errors import InputError
from bodycheck._util.platform_identity import usable_cores
from bodycheck.reports.cache import Reuse

TIMEOUT_S = 120.0
"""Default time limit of one case."""

_IN_FLIGHT = 512
"""Cases that an executor has at most at a time: enough to fill batches for many workers."""


@dataclass(frozen=True)
class OptionFacts:
    """What users read of an option.

    about: a sentence. flag: its name on the command line; "" where it has none. metavar: how its value is
    shown. otherwise: what holds where it is not given, in words. completion: what a shell completes.
    is_stored: whether an interrupted run continues with it.
    """

    about: str
    flag: str = ""
    metavar: str | None = None
    otherwise: str | None = None
    completion: Literal["scenarios", "engines"] | None = None
    is_stored: bool = True


def _option(about: str, flag: str = "", **facts: Any) -> dict[str, Any]:
    """Return the metadata of a field that is an option."""
    return {"option": OptionFacts(about, flag, **facts)}


@dataclass(frozen=True, eq=False)
class Timing:
    """An executor that times cases, and the facts of its machines, all of one class, for the manifest."""

    executor: Executor
    machine: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Execution:
    """How a run is carried out: nothing that changes its results, except for speeds.

    The shards of one run may differ in it. executor: runs the cases. timing: times them elsewhere.
    """

    jobs: int | None = field(
        default=None,
        metadata=_option("Number of cases to run in parallel.", "--jobs", otherwise="one per core"),
    )
    timeout_s: float = field(
        default=TIMEOUT_S,
        metadata=_option(
            "Time limit of one case in s. An engine that exceeds it, as one that hangs, is killed, and the "
            "outcome is timeout; see docs/workers.md.",
            "--timeout-s",
        ),
    )
    fresh: bool | None = field(
        default=None,
        metadata=_option(
            "Run every case again, or reuse results of earlier runs by the same build of an engine.",
            "--fresh/--reuse",
            otherwise="--fresh for gate; --reuse for run and versions, but --fresh for plug-ins and editable "
            "installs",
        ),
    )
    cluster: str | None = field(
        default=None,
        metadata=_option(
            "Run the cases on a Dask cluster, like tcp://scheduler:8786; see docs/clusters.md.",
            "--cluster",
            metavar="ADDRESS",
            otherwise="this machine",
        ),
    )
    tls_ca_file: str | None = field(
        default=None,
        metadata=_option("PEM certificate of the authority that signed the cluster's.", "--tls-ca-file"),
    )
    tls_cert: str | None = field(
        default=None, metadata=_option("PEM certificate of this client.", "--tls-cert")
    )
    tls_key: str | None = field(default=None, metadata=_option("PEM key of this client.", "--tls-key"))
    insecure: bool = field(
        default=False,
        metadata=_option(
            "Allow a cluster on other machines without TLS, in a network that you trust.", "--insecure"
        ),
    )
    engines_file: str | Path | None = field(
        default=None,
        metadata=_option(
            "TOML file that gives programs names for --engine, see docs/workers.md; needs --allow-code.",
            "--engines",
            metavar="FILE",
            otherwise="none",
            is_stored=False,
        ),
    )
    allow_code: bool = field(
        default=False,
        metadata=_option(
            "Allow files to name code that runs: programs, and functions f(t, position, R, velocity, omega) "
            "-> force, torque in scenarios; R is (3, 3), t a number, the others (3,).",
            "--allow-code",
        ),
    )
    executor: Executor | None = field(
        default=None,
        metadata=_option(
            "Runs the cases elsewhere, each as one task; its workers need bodycheck and the engines. "
            "Speeds are measured here.",
            is_stored=False,
        ),
    )
    timing: Timing | None = field(default=None)
    reuse_by_default: Reuse = field(default="installed")

    def __post_init__(self) -> None:
        for one in fields(self):  # kept, and so not to be used up by the first reader
            value = getattr(self, one.name)
            if isinstance(value, Iterable) and not isinstance(value, str):
                with suppress(TypeError):  # an array without a dimension, which `select` refuses
                    object.__setattr__(self, one.name, list(value))
        if self.jobs is not None and (not isinstance(self.jobs, Integral) or self.jobs < 1):
            raise InputError(f"jobs must be a whole number, 1 or more, not {self.jobs!r}")
        if not isinstance(self.timeout_s, Real) or not 0.0 < self.timeout_s < math.inf:
            raise InputError(f"timeout_s must be a positive number of seconds, not {self.timeout_s!r}")

    @property
    def workers(self) -> int:
        """The number of cases to run in parallel."""
        return self.jobs or (usable_cores() if self.executor is None else _IN_FLIGHT)

    @property
    def timing_executor(self) -> Executor | None:
        """The executor that times cases; None to time them in this process."""
        return None if self.timing is None else self.timing.executor

    @property
    def reuse(self) -> Reuse:
        """Which results of earlier runs are reused."""
        return self.reuse_by_default if self.fresh is None else "nothing" if self.fresh else "everything"


@dataclass(frozen=True)
class Request(Execution):
    """What a run measures, and how; as plain data, sufficient to repeat the run.

    The shards of one run have all of it in common, except for `shard`, and what is of `Execution`.
    speed_passes: how often to time every case. stable_steps: whether to search the largest stable step of
    each method. laws: whether to compare each method with the known one-step maps, and to check the laws.
    """

    scenarios: Sequence[str | Path] = field(
        default=("standard",),
        metadata=_option(
            "Built-in scenarios, suites or .toml files.", otherwise="standard", completion="scenarios"
        ),
    )
    _: KW_ONLY
    engines: Sequence[str] | None = field(
        default=None,
        metadata=_option(
            "Engines to run, as NAME[==VERSION][:METHOD],... or cmd:COMMAND.",
            "--engine",
            otherwise="every installed engine",
            completion="engines",
        ),
    )
    dt_s: Iterable[float] | None = field(
        default=None,
        metadata=_option(
            "Step sizes in s of fixed-step methods, like 1e-2,1e-3.", "--dt", otherwise="each scenario's"
        ),
    )
    tolerances: Iterable[float] | None = field(
        default=None,
        metadata=_option(
            "Error tolerances of the adaptive methods, like 1e-6,1e-9.",
            "--tolerance",
            otherwise="each method's",
        ),
    )
    speed: bool = field(default=True, metadata=_option("Measure CPU time.", "--no-speed"))
    shard: str | None = field(
        default=None,
        metadata=_option(
            "Run part K of N, chosen by a hash, like 3/8; `bodycheck merge` combines the parts.",
            "--shard",
            metavar="K/N",
            otherwise="the whole run",
        ),
    )
    commit: str | None = field(
        default=None,
        metadata=_option(
            "The commit of the engine that is measured; changes are reported with their range of commits.",
            "--commit",
            metavar="ID",
            otherwise="that of the environment of GitHub Actions, GitLab CI, ...",
        ),
    )
    speed_passes: int = field(default=1)
    stable_steps: bool = field(default=True)
    laws: bool = field(default=True)

    @property
    def data(self) -> dict[str, Any]:
        """Return the request as plain data, by option."""
        return {one.name: _plain(getattr(self, one.name)) for one in stored_fields()}


def options() -> dict[str, tuple[Field[Any], OptionFacts]]:
    """Return the options by name, each with its field; first what is measured, then how."""
    found = {one.name: (one, one.metadata["option"]) for one in fields(Request) if "option" in one.metadata}
    how = {each.name for each in fields(Execution)}
    return dict(sorted(found.items(), key=lambda item: item[0] in how))


def stored_fields() -> tuple[Field[Any], ...]:
    """Return the fields with which an interrupted run is continued."""
    unstored = {name for name, (_, option) in options().items() if not option.is_stored}
    return tuple(one for one in fields(Request) if one.name not in unstored | {"timing", "reuse_by_default"})


def undivided(request: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a stored request that all shards of a run have in common.

    Scenarios and engines are compared by what they resolved to.
    """
    free = {each.name for each in fields(Execution)} | {"scenarios", "engines", "shard"}
    names = (each.name for each in stored_fields() if each.name not in free)
    return {name: request[name] for name in names if name in request}


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [
            one if isinstance(one, str) else str(one) if isinstance(one, Path) else float(one)
            for one in value
        ]
    return value


_P = ParamSpec("_P")
_Result = TypeVar("_Result")


def with_options_of(
    request: Callable[_P, Request],
) -> Callable[[Callable[[Request], _Result]], Callable[_P, _Result]]:
    """Return a decorator: the function takes the parameters of a request, which its docstring lists."""

    def decorate(function: Callable[[Request], _Result]) -> Callable[_P, _Result]:
        @wraps(function)
        def with_options(*args: _P.args, **kwargs: _P.kwargs) -> _Result:
            try:
                given = request(*args, **kwargs)
            except TypeError as error:
                raise TypeError(str(error).replace("Request.__init__", function.__name__)) from None
            return function(given)

        own = inspect.signature(Request)
        shown = [one for name, one in own.parameters.items() if name in options()]
        result = inspect.signature(function).return_annotation
        with_options.__signature__ = inspect.Signature(shown, return_annotation=result)  # type: ignore[attr-defined]
        texts = " ".join(
            f"{name}: {one.about[:-1]}{f' [default: {one.otherwise}]' if one.otherwise else ''}."
            for name, (_, one) in options().items()
        )
        with_options.__doc__ = f"{inspect.cleandoc(function.__doc__ or '')}\n\n{texts}\n"
        return with_options

    return decorate
