"""Calls of uv, which creates environments and finds the releases of a package."""

from __future__ import annotations

import ast
import hashlib
import os
import shutil
import subprocess
import sys
from functools import cache
from importlib import import_module
from pathlib import Path

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck.adapters.engine_names import engine_fault, is_version
from bodycheck.adapters.registry import distribution_of

_REFUSED = 1  # uv's status if there is no such package or version, as opposed to wrong usage or no network
_LONGEST = 400

_PIP_TO_UV = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "cert": "SSL_CERT_FILE",
}
_SEPARATORS = {"find-links": ","}
_PIP_SECTIONS = ("global", "install", ":env:")  # later sections override earlier ones
_SYSTEM_FILES = (Path("/etc/xdg/uv/uv.toml"), Path("/etc/uv/uv.toml"))
_UV_INDEXES = ("UV_DEFAULT_INDEX", "UV_INDEX_URL", "UV_INDEX", "UV_EXTRA_INDEX_URL")
_SOURCES = (*_UV_INDEXES, "UV_FIND_LINKS", "UV_NO_INDEX", "UV_INDEX_STRATEGY", "UV_CONSTRAINT", "UV_OVERRIDE")


class UvError(UnavailableError):
    """uv failed; refused: because there is no such package or version, not because of the network."""

    def __init__(self, message: str, *, refused: bool) -> None:
        super().__init__(message)
        self.refused = refused


_PROGRESS = ("Resolved", "Building", "Downloading", "Downloaded", "Prepared", "Installed")
_REMARKS = ("Using ", "warning: ")


def uv(*words: str, stdin: str = "", downloads: bool = False, progress: bool = False) -> str:
    """Run uv with these arguments and this standard input; return its standard output.

    downloads: whether it may download a Python that is not installed. progress: whether to print on standard
    error what it resolves, downloads and installs.

    Raises UnavailableError if uv is not installed, UvError with uv's message in one line if it fails.
    """
    environment = {
        **os.environ,
        **pip_settings(),
        **_users_configuration(),
        "UV_PYTHON_DOWNLOADS": "automatic" if downloads else "never",
        "NO_COLOR": "1",
    }
    if progress:
        status, output, errors = _watched([uv_program(), *words], environment)
    else:
        command = [uv_program(), "--quiet", *words]
        done = subprocess.run(
            command, input=stdin, capture_output=True, text=True, env=environment, check=False
        )
        status, output, errors = done.returncode, done.stdout, done.stderr
    if status != 0:
        raise UvError(in_one_line(errors), refused=status == _REFUSED)
    return output


def _watched(command: list[str], environment: dict[str, str]) -> tuple[int, str, str]:
    """Run uv and print its steps while it works; return its status, "", and its other messages."""
    errors: list[str] = []
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        for line in process.stderr or ():
            if line.strip().startswith(_PROGRESS):
                print(f"  {line.strip()}", file=sys.stderr, flush=True)
            elif not line.startswith(_REMARKS):
                errors.append(line)
    return process.returncode, "", "".join(errors)


def _users_configuration() -> dict[str, str]:
    """Make uv read the user's or the system's configuration, but not that of the working directory.

    The working directory may belong to someone else's project and name an untrusted index. Naming a file
    replaces all those that uv would search.
    """
    named = os.environ.get("UV_CONFIG_FILE")
    files = (Path(named) if named else None, _users_file(), *_SYSTEM_FILES)
    found = next((str(file) for file in files if file is not None and file.is_file()), None)
    return {"UV_NO_CONFIG": "1"} if found is None else {"UV_CONFIG_FILE": found}


def _users_file() -> Path | None:
    """Return the path of the user's configuration; None for a user without a home folder."""
    try:
        return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config", "uv", "uv.toml")
    except RuntimeError:  # neither HOME nor an entry in the user database
        return None


def index_settings() -> list[str]:
    """Return the sources of packages: the variables that uv reads, and a hash of its configuration."""
    variables = {**os.environ, **pip_settings()}
    settings = [f"{name}={variables[name]}" for name in _SOURCES if variables.get(name)]
    if file := _users_configuration().get("UV_CONFIG_FILE"):
        settings.append(f"{file} {hashlib.sha256(Path(file).read_bytes()).hexdigest()}")
    return settings


def uv_program() -> str:
    """Return the path of uv; raises UnavailableError if it is not installed."""
    try:
        found: str | None = import_module("uv").find_uv_bin()
    except (ImportError, OSError):
        found = shutil.which("uv")
    if found is None:
        raise UnavailableError("environments of engines require uv: pip install 'bodycheck[versions]'")
    return found


def in_one_line(output: str) -> str:
    """Return a program's message in one line, without the marks of its layout."""
    lines = (line.strip(" ×│╰─▶").removeprefix("cause: ") for line in output.splitlines())
    text = " ".join(line for line in lines if line).removeprefix("error: ")
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def pip_settings() -> dict[str, str]:
    """Return pip's settings of indexes and certificates as uv's variables; none if uv has its own indexes.

    uv does not read pip's configuration, which is often the only one on a machine with its own package index.
    """
    if any(name in os.environ for name in _UV_INDEXES):
        return {}
    configured = _settings(_pip_config())
    found = {
        variable: _SEPARATORS.get(name, " ").join(configured[name].split())
        for name, variable in _PIP_TO_UV.items()
        if configured.get(name) and variable not in os.environ
    }
    if "UV_INDEX" in found:
        found["UV_INDEX_STRATEGY"] = "unsafe-best-match"  # as pip does
    return found


@cache
def _pip_config() -> str:
    """Return the output of `pip config list`; empty if there is no pip."""
    # -P: the working directory may have a folder named pip
    command = [sys.executable, "-P", "-m", "pip", "config", "list"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else ""


def _settings(listed: str) -> dict[str, str]:
    """Return name -> value from the lines of `pip config list`: section.name='value'."""
    found: dict[tuple[str, str], str] = {}
    for line in listed.splitlines():
        key, sign, value = line.partition("=")
        section, _, name = key.rpartition(".")
        if sign and section in _PIP_SECTIONS:
            found[section, name] = str(ast.literal_eval(value))
    ordered = sorted(found, key=lambda key: _PIP_SECTIONS.index(key[0]))
    return {name: found[section, name] for section, name in ordered}


def releases(engine: str, since: str, until: str | None) -> tuple[str, ...]:
    """Return the releases from `since` to `until`, both included, oldest first; until None: to the newest.

    Only releases with a wheel for this Python count, no pre-releases and no yanked ones. uv has no list of
    releases but resolves what can be installed, so request the newest, then the newest before that.

    Raises InputError if there is no release or a version is invalid, UnavailableError if uv fails.
    """
    for option, version in (("--since", since), ("--until", until)):
        if version is not None and not is_version(version):
            raise InputError(f"{option} {version}: not a version (expected one like 3.6.0)")
    if fault := engine_fault(f"{engine}=={since}"):
        raise InputError(fault)
    found: list[str] = []
    below = "" if until is None else f",<={until}"
    while True:
        try:
            found.append(_newest(f"{distribution_of(engine)}>={since}{below}"))
        except UvError as error:
            if not error.refused:
                raise
            if not found:
                raise InputError(f"{engine}: no release that can be installed here: {error}") from None
            return tuple(reversed(found))
        below = f",<{found[-1]}"


def _newest(requirement: str) -> str:
    """Return the newest version that meets the requirement."""
    line = uv(
        *("pip", "compile", "--python", sys.executable, "--no-deps", "--no-build", "--no-header"),
        *("--no-annotate", "--prerelease", "disallow", "-"),
        stdin=f"{requirement}\n",
    )
    return line.strip().partition("==")[2]
