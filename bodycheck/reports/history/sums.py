"""What a nightly run wrote, by its SHA-256: a past run is data from outside, and any damage to it shows.

night.json, which is written last, holds the sum of every other file and a seal over its own content. Runs
that were stored before there were sums are known by neither of the two keys; their files are read in full.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bodycheck.errors import InputError
from bodycheck.outside import escaped, printable, read_json

NIGHT_FILE = "night.json"
_SUMS, _SEAL = "sha256", "seal"
_PARQUET = b"PAR1"  # a whole file begins and ends with it


def seal_night(folder: Path) -> None:
    """Add the sums of all files of a nightly run, and the seal, to its night.json."""
    path = folder / NIGHT_FILE
    told = json.loads(path.read_text(encoding="utf-8"))
    told[_SUMS] = {file.name: _sum(file) for file in sorted(folder.iterdir()) if file != path}
    told[_SEAL] = _seal(told)
    path.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


def read_night_file(folder: Path) -> dict[str, Any]:
    """Read night.json of a nightly run; InputError where it cannot be read or is not as it was written."""
    path = folder / NIGHT_FILE
    try:
        told = read_json(path, escape=False)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not isinstance(told, dict):
        raise InputError(f"{path}: is damaged: it should be an object")
    if {_SUMS, _SEAL} & told.keys() and told.get(_SEAL) != _seal(told):
        raise InputError(f"{path}: is damaged: it is not as it was written")
    return {name: value for name, value in escaped(told).items() if name != _SEAL}


def check_files(folder: Path, told: dict[str, Any], names: Iterable[str] | None = None) -> None:
    """Raise InputError, which names it, where a file of a nightly run is not as it was written.

    told: its night.json. names: of the files to look at; all, if not given.
    """
    sums = told.get(_SUMS)
    if sums is None:
        for path in sorted(folder.glob("*.parquet")) if names is None else [folder / name for name in names]:
            _check_parquet(path)
        return
    for name in sums if names is None else names:
        path = folder / name
        try:
            found = _sum(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
        if found != sums.get(name):
            raise InputError(f"{path}: is damaged: it is not as it was written")


def _check_parquet(path: Path) -> None:
    """Raise InputError where a Parquet file without a known sum cannot be read in full."""
    import duckdb

    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not (len(content) > 2 * len(_PARQUET) and content.startswith(_PARQUET) and content.endswith(_PARQUET)):
        raise InputError(f"{path}: is damaged")
    try:
        with duckdb.connect() as database:
            database.read_parquet(str(path)).fetchall()
    except (duckdb.Error, ValueError, OverflowError) as error:
        raise InputError(f"{path}: is damaged: {printable(' '.join(str(error).split()), 200)}") from None


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _seal(told: dict[str, Any]) -> str:
    content = {name: value for name, value in told.items() if name != _SEAL}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
