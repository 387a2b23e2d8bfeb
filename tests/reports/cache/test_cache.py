"""The cache: complete entries are used, others count as absent, and no error of the cache ends a run."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bodycheck._util.files import sealed
from bodycheck.reference_impl.scene import CallbackLoad, RigidBody, Scene, State
from bodycheck.reference_impl.truth import certification as truth
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.reports.cache import disk_cache, truths
from bodycheck.reports.cache.disk_cache import Cache, key_of
from bodycheck.reports.cache.truths import is_known, known_truth
from tests.helpers.file_size_limit import file_size_limit

KEY, OTHER = key_of(case=1), key_of(case=2)
MESSAGE = {"outcome": "ok", "message": "as it was"}
DAY_S = 86400.0


def place_of(folder: Path, key: str) -> Path:
    """Return where a message lies."""
    return folder / key[:2] / key[2:]


def test_entry_is_found_by_its_key_only(tmp_path: Path) -> None:
    """Another cache on the same folder finds the newest entry, under no other key."""
    Cache(tmp_path).put(KEY, {"outcome": "failed"})
    Cache(tmp_path).put(KEY, MESSAGE)
    assert Cache(tmp_path).get(KEY) == MESSAGE
    assert Cache(tmp_path).get(OTHER) is None


def test_cache_in_write_mode_replaces_entries(tmp_path: Path) -> None:
    """With --fresh nothing is read, and the next run has the new answers."""
    Cache(tmp_path).put(KEY, {"outcome": "unsupported"})
    fresh = Cache(tmp_path).write_only()
    assert fresh.get(KEY) is None
    fresh.put(KEY, MESSAGE)
    assert Cache(tmp_path).get(KEY) == MESSAGE


DAMAGES: dict[str, Callable[[Path], object]] = {
    "cut off": lambda place: place.write_bytes(place.read_bytes()[:-2]),
    "changed": lambda place: place.write_bytes(place.read_bytes().replace(b"as it was", b"as it is.")),
    "emptied": lambda place: place.write_bytes(b""),
    "of zeros": lambda place: place.write_bytes(bytes(200)),
    "no JSON": lambda place: place.write_bytes(b"\xff\n"),
    "a folder": lambda place: (place.unlink(), place.mkdir()),
    "a link to nowhere": lambda place: (place.unlink(), place.symlink_to("nowhere")),
    "of another key": lambda place: place.write_bytes(place_of(place.parents[1], OTHER).read_bytes()),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_file_counts_as_absent(damage: str, tmp_path: Path) -> None:
    """A damaged entry is not found, and the next entry replaces it if a file can be written."""
    Cache(tmp_path).put(KEY, MESSAGE)
    Cache(tmp_path).put(OTHER, {"outcome": "unsupported"})
    DAMAGES[damage](place_of(tmp_path, KEY))
    cache = Cache(tmp_path)
    assert cache.get(KEY) is None
    cache.put(KEY, MESSAGE)
    assert cache.get(KEY) == (None if damage == "a folder" else MESSAGE)
    assert not list(tmp_path.glob("*/.*"))


def test_full_disk_leaves_no_truncated_file(tmp_path: Path) -> None:
    """After the first failure nothing more is written; stored entries stay."""
    cache = Cache(tmp_path)
    cache.put(KEY, MESSAGE)
    with file_size_limit(20):
        cache.put(OTHER, MESSAGE)
    cache.put(OTHER, MESSAGE)
    assert (cache.get(KEY), cache.get(OTHER)) == (MESSAGE, None)
    assert [path for path in tmp_path.glob("*/*") if path.is_file()] == [place_of(tmp_path, KEY)]


@pytest.mark.parametrize("blocked", ["a file", "a link to nothing that can be"])
def test_unwritable_folder_is_an_empty_cache(blocked: str, tmp_path: Path) -> None:
    """Nothing is found or stored, and nothing fails."""
    folder = tmp_path / "cache"
    if blocked == "a file":
        folder.touch()
    else:
        folder.symlink_to("/proc/nothing")
    cache = Cache(folder)
    cache.put(KEY, MESSAGE)
    cache.prune()
    assert cache.get(KEY) is None


def test_pruning_removes_what_was_not_used_for_a_month(tmp_path: Path) -> None:
    """A file that was read recently stays, another goes, whatever its name."""
    cache = Cache(tmp_path)
    for key in (KEY, OTHER):
        cache.put(key, MESSAGE)
        os.utime(place_of(tmp_path, key), (0.0, 0.0))
    assert cache.get(KEY) == MESSAGE
    used = place_of(tmp_path, KEY).stat().st_mtime
    cache.prune(now_s=used + 29.9 * DAY_S)
    assert (cache.get(KEY), cache.get(OTHER)) == (MESSAGE, None)
    cache.prune(now_s=used + 30.0 * DAY_S)
    assert cache.get(KEY) is None


def test_folder_is_pruned_at_most_once_an_hour(tmp_path: Path) -> None:
    """A second pruning removes nothing within an hour of the first, unless the clock was set back."""
    cache = Cache(tmp_path)
    now_s = time.time()
    cache.prune(now_s)
    for later_s, pruned in ((3599.0, False), (3601.0, True), (-86400.0, True)):
        cache.put(KEY, MESSAGE)
        os.utime(place_of(tmp_path, KEY), (0.0, 0.0))
        Cache(tmp_path).prune(now_s + later_s)
        assert place_of(tmp_path, KEY).exists() != pruned


def test_default_cache_moves_with_the_cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """BODYCHECK_CACHE_DIR moves it; its entries are in `results`."""
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path))
    Cache.default().put(KEY, MESSAGE)
    assert Cache.default().get(KEY) == MESSAGE
    assert place_of(tmp_path / "results", KEY).is_file()


def test_unreadable_folder_is_not_pruned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder may belong to another user or be removed meanwhile, which is not an error."""
    Cache(tmp_path).put(KEY, MESSAGE)

    def refused(folder: Path) -> Iterator[Path]:
        raise PermissionError(folder)

    monkeypatch.setattr(Path, "iterdir", refused)
    Cache(tmp_path).prune(now_s=1e12)
    assert Cache(tmp_path).get(KEY) == MESSAGE


def test_time_of_use_is_updated_once_a_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time is unchanged within a day, and becomes the present after that or if it is in the future."""
    cache, now = Cache(tmp_path), float(int(time.time()))
    cache.put(KEY, MESSAGE)
    monkeypatch.setattr(disk_cache, "time", SimpleNamespace(time=lambda: now))
    for age, marked in ((DAY_S, False), (DAY_S + 1.0, True), (-DAY_S, False), (-1.5 * DAY_S, True)):
        os.utime(place_of(tmp_path, KEY), (now - age, now - age))
        assert cache.get(KEY) == MESSAGE
        found = place_of(tmp_path, KEY).stat().st_mtime
        assert abs(found - (now if marked else now - age)) < 100.0


def test_pruning_removes_the_longest_unused_above_its_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Above the limit the oldest go first, and no more than needed."""
    keys = [key_of(case=n) for n in range(4)]
    size = len(sealed({"key": keys[0], "value": MESSAGE}))
    cache = Cache(tmp_path)
    for age, key in enumerate(keys):
        cache.put(key, MESSAGE)
        os.utime(place_of(tmp_path, key), (1000.0 - age, 1000.0 - age))
    monkeypatch.setattr("bodycheck.reports.cache.disk_cache._MAX_BYTES", 2 * size)
    cache.prune(now_s=1000.0)
    assert [key for key in keys if place_of(tmp_path, key).exists()] == keys[:2]


def test_cache_has_at_most_two_gigabytes_after_pruning(tmp_path: Path) -> None:
    """One byte more, and the entry that was not used for longest goes."""
    cache = Cache(tmp_path)
    for age, key in enumerate((KEY, OTHER)):
        cache.put(key, MESSAGE)
        os.truncate(place_of(tmp_path, key), 1_000_000_000)
        os.utime(place_of(tmp_path, key), (1000.0 - age, 1000.0 - age))
    cache.prune(now_s=1000.0)
    assert [place_of(tmp_path, key).exists() for key in (KEY, OTHER)] == [True, True]
    os.truncate(place_of(tmp_path, OTHER), 1_000_000_001)
    os.utime(place_of(tmp_path, OTHER), (999.0, 999.0))
    cache.prune(now_s=5000.0)
    assert [place_of(tmp_path, key).exists() for key in (KEY, OTHER)] == [True, False]


def spinning(rate: float) -> Scene:
    """Return a body that spins freely."""
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([rate, 1.0, 0.2]))
    return Scene(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])), start, (), np.zeros(3), 1.0, 3)


def test_truth_is_computed_once_and_stored_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All arrays and texts are as computed; another scene or other times are computed again."""
    solved: list[float] = []
    solve = truth.solve_truth

    def counted(scene: Scene, t_s: np.ndarray) -> Truth:
        solved.append(float(t_s[-1]))
        return solve(scene, t_s)

    monkeypatch.setattr(truth, "solve_truth", counted)
    cache, times = Cache(tmp_path), np.array([0.0, 0.5, 1.0])
    first, again = (known_truth(spinning(0.3), times, cache) for _ in range(2))
    assert len(solved) == 1
    for part in vars(first.trajectory):
        before, after = getattr(first.trajectory, part), getattr(again.trajectory, part)
        assert (before is None and after is None) or before.tobytes() == after.tobytes()
    assert all(
        np.array_equal(value, getattr(again, name))
        for name, value in vars(first).items()
        if name != "trajectory"
    )
    known_truth(spinning(np.nextafter(0.3, 1.0)), times, cache)
    known_truth(spinning(0.3), times + 1e-3, cache)
    for code in ("own_code", "digest_of"):
        monkeypatch.setattr(truths, code, lambda *_: "other code")
        known_truth(spinning(0.3), times, cache)
    assert len(solved) == 5
    installed = truths.numeric_parts()
    for part in installed:
        monkeypatch.setattr(truths, "numeric_parts", lambda p=part: {**installed, p: "another"})
        known_truth(spinning(0.3), times, cache)
    assert len(solved) == 5 + len(installed)
    assert {"python", "numpy", "numba", "llvmlite", "processor", "environment"} <= installed.keys()


@pytest.mark.parametrize("what", ["no cache", "a user's function"])
def test_truth_that_may_change_is_solved_each_time(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a cache, and under a function whose code may change, nothing is stored or known."""
    solved: list[Scene] = []
    answer = object()

    def solve(scene: Scene, t_s: np.ndarray) -> object:
        assert t_s is times
        solved.append(scene)
        return answer

    monkeypatch.setattr(truth, "solve_truth", solve)
    monkeypatch.setattr(truths, "closed_forms_compiled", lambda: True)
    cache, times, scene = Cache(tmp_path), np.array([0.0, 1.0]), spinning(0.3)
    if what != "no cache":
        load = CallbackLoad("loads:f", lambda *_: (np.zeros(3), np.zeros(3)))
        scene = replace(scene, loads=(load,))
    for _ in range(2):
        assert known_truth(scene, times, None if what == "no cache" else cache) is answer
    assert solved == [scene, scene]
    assert list(tmp_path.iterdir()) == []
    assert not is_known(scene, times, cache)


def test_stored_truth_is_reported_as_known(tmp_path: Path) -> None:
    """A truth is known after it was computed, at these times only, and never with --fresh."""
    cache, times = Cache(tmp_path), np.array([0.0, 0.5, 1.0])
    assert not is_known(spinning(0.3), times, cache)
    known_truth(spinning(0.3), times, cache)
    assert is_known(spinning(0.3), times, cache)
    assert not is_known(spinning(0.3), times[:2], cache)
    assert not is_known(spinning(0.3), times, cache.write_only())


@pytest.mark.parametrize(("compiled", "interprets"), [(True, False), (False, True), (False, False)])
def test_truth_compiles_missing_closed_forms_unless_it_interprets_them(
    compiled: bool, interprets: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels that are compiled already, or not needed, are not compiled for each truth."""
    called: list[int] = []
    monkeypatch.setattr(truths, "closed_forms_compiled", lambda: compiled)
    monkeypatch.setattr(truths, "interprets_closed_forms", lambda _: interprets)
    monkeypatch.setattr(truths, "compile_kernels", lambda scenes: called.append(len(scenes)))
    known_truth(spinning(0.3), np.array([0.0, 1.0]), Cache(tmp_path))
    assert called == ([] if compiled or interprets else [1])
