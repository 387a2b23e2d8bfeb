"""Hashes of file contents, cached until a file changes."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from bodycheck._util.cache_dir import cache_dir
from bodycheck._util.files import atomic_write, opened, sealed

_RACY_NS = 2_000_000_000
"""A file modified this recently may change again within one time stamp: FAT has a resolution of 2 s."""

Entry = tuple[str, os.stat_result]
"""A path and its os.stat_result."""


def files_below(folder: str) -> dict[str, Entry]:
    """Return relative path -> entry of the files in and below a folder.

    Skips __pycache__, hidden folders, and files that vanish or cannot be read.
    """
    begin = len(folder) + 1  # faster than os.path.relpath, which would take half of the time
    return {path[begin:]: (path, status) for path, status in _walk(folder)}


def _walk(folder: str) -> Iterator[Entry]:
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in entries:
        with suppress(OSError):
            if entry.is_dir(follow_symlinks=False):
                if entry.name != "__pycache__" and not entry.name.startswith("."):
                    yield from _walk(entry.path)
            else:
                yield entry.path, entry.stat()


def disk_bytes(folders: Iterable[Path]) -> int:
    """Return the bytes of the files in and below folders; a file with several hard links counts once."""
    files = (status for folder in folders for _, status in _walk(str(folder)))
    return sum({(status.st_dev, status.st_ino): status.st_size for status in files}.values())


def files_at(paths: Iterable[str]) -> Iterator[Entry]:
    """Yield the entries of those paths that exist."""
    for path in paths:
        with suppress(OSError):
            yield path, Path(path).stat()


def content_digest(label: str, files: Mapping[str, Entry]) -> str:
    """Return a hash of the contents and names of files.

    files: name -> path and its status. The hash is computed once per state of the files: path, size, times of
    modification and of change in ns, inode and device. label: key of the cache file that stores the newest
    state and its hash; if that file cannot be written, nothing is cached.
    """
    named = sorted(files.items())
    state = _state(named)
    cache_file = cache_dir() / "digests" / hashlib.sha256(label.encode()).hexdigest()
    if (found := _stored_digest(cache_file, state)) is not None:
        return found
    begin_ns = time.time_ns()
    digest = hashlib.sha256()
    for name, (path, _) in named:
        digest.update(f"{name}\0{_file_digest(path)}\n".encode())
    again = _state([(name, (path, _status(path))) for name, (path, _) in named])
    is_settled = all(max(s.st_mtime_ns, s.st_ctime_ns) < begin_ns - _RACY_NS for _, (_, s) in named)
    if again == state and is_settled:
        _store_digest(cache_file, state, digest.hexdigest())
    return digest.hexdigest()


def _state(named: Sequence[tuple[str, tuple[str, os.stat_result | None]]]) -> str:
    facts = [
        (name, path, s and (s.st_size, s.st_mtime_ns, s.st_ctime_ns, s.st_ino, s.st_dev))
        for name, (path, s) in named
    ]
    return hashlib.sha256(repr(facts).encode()).hexdigest()


def _status(path: str) -> os.stat_result | None:
    try:
        return Path(path).stat()
    except OSError:
        return None


def _file_digest(path: str) -> str:
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        return f"cannot be read: {error.errno}"


def _stored_digest(cache_file: Path, state: str) -> str | None:
    try:
        stored = opened(cache_file.read_bytes())
    except (OSError, ValueError):
        return None
    if stored is None or stored.get("state") != state:
        return None
    return str(stored["digest"])


def _store_digest(cache_file: Path, state: str, digest: str) -> None:
    """Write the cache file atomically, because other processes may write it at the same time."""
    with suppress(OSError):
        cache_file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(cache_file, sealed({"state": state, "digest": digest}))


def digest_of(folder: Path) -> str:
    """Return a hash of all the Python sources in and below a folder, and of their places in it."""
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        digest.update(source.relative_to(folder).as_posix().encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()
