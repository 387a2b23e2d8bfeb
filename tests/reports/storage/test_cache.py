"""The cache: what is whole is used, anything else is as if it were not there, and nothing fails for it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from full_disk import no_file_longer_than

from bodycheck._util.checksummed_json import sealed
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reference_impl.truth import certification as truth
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.reports.cache import truths
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.entries import key_of
from bodycheck.reports.cache.truths import is_known, known_truth

KEY, OTHER = key_of(case=1), key_of(case=2)
MESSAGE = {"outcome": "ok", "message": "as it was"}
DAY_S = 86400.0


def place_of(folder: Path, key: str) -> Path:
    """Return where a message lies."""
    return folder / key[:2] / key[2:]


def test_what_was_put_is_found_by_its_key_alone(tmp_path: Path) -> None:
    """Another cache on the same folder finds it, under no other key, and in its newest form."""
    Cache(tmp_path).put(KEY, {"outcome": "failed"})
    Cache(tmp_path).put(KEY, MESSAGE)
    assert Cache(tmp_path).get(KEY) == MESSAGE
    assert Cache(tmp_path).get(OTHER) is None


def test_a_cache_that_is_only_written_replaces_what_is_there(tmp_path: Path) -> None:
    """--fresh asks anew, and the next run has the new answers."""
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
def test_a_damaged_file_counts_as_absent(damage: str, tmp_path: Path) -> None:
    """It is not found, and what is put after it neither fails nor is lost, where a file can be put."""
    Cache(tmp_path).put(KEY, MESSAGE)
    Cache(tmp_path).put(OTHER, {"outcome": "unsupported"})
    DAMAGES[damage](place_of(tmp_path, KEY))
    cache = Cache(tmp_path)
    assert cache.get(KEY) is None
    cache.put(KEY, MESSAGE)
    assert cache.get(KEY) == (None if damage == "a folder" else MESSAGE)
    assert not list(tmp_path.glob("*/.*"))


def test_a_full_disk_leaves_no_half_file_and_is_not_tried_again(tmp_path: Path) -> None:
    """A message that finds no room is not kept, nor any after it; what was kept stays."""
    cache = Cache(tmp_path)
    cache.put(KEY, MESSAGE)
    with no_file_longer_than(20):
        cache.put(OTHER, MESSAGE)
    cache.put(OTHER, MESSAGE)
    assert (cache.get(KEY), cache.get(OTHER)) == (MESSAGE, None)
    assert [path for path in tmp_path.glob("*/*") if path.is_file()] == [place_of(tmp_path, KEY)]


@pytest.mark.parametrize("blocked", ["a file", "a link to nothing that can be"])
def test_a_folder_that_cannot_be_written_is_a_full_one(blocked: str, tmp_path: Path) -> None:
    """Nothing is found, nothing is kept, nothing fails."""
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
    """A file that was read lately stays, one that was not goes, of whatever name."""
    cache = Cache(tmp_path)
    for key in (KEY, OTHER):
        cache.put(key, MESSAGE)
        os.utime(place_of(tmp_path, key), (0.0, 0.0))
    assert cache.get(KEY) == MESSAGE
    cache.prune(now_s=place_of(tmp_path, KEY).stat().st_mtime + 29 * DAY_S)
    assert (cache.get(KEY), cache.get(OTHER)) == (MESSAGE, None)


def test_a_folder_that_cannot_be_listed_is_not_pruned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be somebody else's, or be gone at this very moment: no run ends for that."""
    Cache(tmp_path).put(KEY, MESSAGE)

    def refused(folder: Path) -> Iterator[Path]:
        raise PermissionError(folder)

    monkeypatch.setattr(Path, "iterdir", refused)
    Cache(tmp_path).prune(now_s=1e12)
    assert Cache(tmp_path).get(KEY) == MESSAGE


def test_a_file_that_was_used_today_is_not_marked_again(tmp_path: Path) -> None:
    """Its time stays as it is within a day, and becomes the present after that, also from the future."""
    cache, now = Cache(tmp_path), time.time()
    cache.put(KEY, MESSAGE)
    for age, marked in ((0.5 * DAY_S, False), (1.5 * DAY_S, True), (-1.5 * DAY_S, True)):
        os.utime(place_of(tmp_path, KEY), (now - age, now - age))
        assert cache.get(KEY) == MESSAGE
        found = place_of(tmp_path, KEY).stat().st_mtime
        assert abs(found - (now if marked else now - age)) < 100.0


def test_pruning_keeps_to_its_size_by_removing_the_longest_unused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Above the limit the oldest go first, and no more than needed."""
    keys = [key_of(case=n) for n in range(4)]
    size = len(sealed({"key": keys[0], "value": MESSAGE}))
    cache = Cache(tmp_path)
    for age, key in enumerate(keys):
        cache.put(key, MESSAGE)
        os.utime(place_of(tmp_path, key), (1000.0 - age, 1000.0 - age))
    monkeypatch.setattr("bodycheck.reports.cache.disk_cache._MOST_BYTES", 2 * size)
    cache.prune(now_s=1000.0)
    assert [key for key in keys if place_of(tmp_path, key).exists()] == keys[:2]


def spinning(rate: float) -> Scene:
    """Return a body that spins freely."""
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([rate, 1.0, 0.2]))
    return Scene(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])), start, (), np.zeros(3), 1.0, 3)


def test_a_truth_is_solved_once_and_comes_back_to_the_last_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All its arrays and words are as they were solved; another scene or other times are solved anew."""
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
    monkeypatch.setattr(truths, "own_code", lambda: "other code")
    known_truth(spinning(0.3), times, cache)
    assert len(solved) == 4
    installed = truths.numeric_parts()
    for part in installed:
        monkeypatch.setattr(truths, "numeric_parts", lambda p=part: {**installed, p: "another"})
        known_truth(spinning(0.3), times, cache)
    assert len(solved) == 4 + len(installed)
    assert {"python", "numpy", "numba", "llvmlite", "processor", "environment"} <= installed.keys()


def test_a_truth_is_known_where_it_would_be_found(tmp_path: Path) -> None:
    """It is known once it was solved, at these times alone, and never to a run that asks all anew."""
    cache, times = Cache(tmp_path), np.array([0.0, 0.5, 1.0])
    assert not is_known(spinning(0.3), times, cache)
    known_truth(spinning(0.3), times, cache)
    assert is_known(spinning(0.3), times, cache)
    assert not is_known(spinning(0.3), times[:2], cache)
    assert not is_known(spinning(0.3), times, cache.write_only())


@pytest.mark.parametrize("compiled", [True, False])
def test_a_truth_compiles_only_closed_forms_that_are_missing(
    compiled: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the run, or an earlier one, has compiled is not gone through again for each truth."""
    called: list[int] = []
    monkeypatch.setattr(truths, "closed_forms_compiled", lambda: compiled)
    monkeypatch.setattr(truths, "compile_kernels", lambda scenes: called.append(len(scenes)))
    known_truth(spinning(0.3), np.array([0.0, 1.0]), Cache(tmp_path))
    assert called == ([] if compiled else [1])
