"""Files of compiled kernels are checked, and a damaged one is compiled again once."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import cache_files, jit


def _doubled(x: float) -> float:
    return 2.0 * x


def _at(a: Array, i: int) -> float:
    return float(a[i])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder in which the kernels of a test are stored."""
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path)
    return tmp_path


def used() -> Any:
    """Return a new kernel of the same function after calling it once."""
    made = jit.kernel(_doubled)
    assert made(1.5) == 3.0
    return made


def found(kernel: Any) -> bool:
    """Return whether a kernel loaded its code from disk."""
    return bool(sum(kernel.dispatcher.stats.cache_hits.values()))


def _flipped(content: bytes) -> bytes:
    place = random.Random(7).randrange(len(content))
    return content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :]


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "cut off": lambda content: content[: len(content) // 2],
    "zeros": lambda content: bytes(len(content)),
    "flipped": _flipped,
    "longer": lambda content: content + b"x",
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_damaged_kernel_file_is_rebuilt_once(folder: Path, suffix: str, damage: str) -> None:
    """The function works, the damaged file is replaced, and the next dispatcher accepts it."""
    assert not found(used())
    assert found(used())
    (path,) = folder.rglob(f"*.{suffix}")
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    assert not found(used())
    assert found(used())


def test_kernel_files_of_numba_itself_are_replaced(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files without a digest, as an earlier release wrote them, count as damaged."""
    monkeypatch.setattr(cache_files, "check_files_of", lambda dispatcher: dispatcher)
    used()
    monkeypatch.undo()
    monkeypatch.setattr(jit, "cache_directory", lambda: folder)
    assert not found(used())
    assert found(used())


def test_full_disk_prints_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A kernel that cannot be stored still works, and the reason is printed once."""

    def full(*_: Any, **__: Any) -> Any:
        raise OSError(28, "No space left on device")

    from bodycheck.reference_impl.kernels.cache_files import CheckedCacheFile

    monkeypatch.setattr(CheckedCacheFile, "_open_for_write", full)
    used()
    used()
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert message.endswith(
        "cannot be written: No space left on device; compiled code is cached for this command only\n"
    )
    assert str(folder) in message


@pytest.mark.parametrize("decorator", [jit.borrowing_inline, jit.unspecialised_kernel])
def test_kernel_is_compiled_once_for_all_integers(decorator: Callable[..., Any], folder: Path) -> None:
    """Not for each constant in a call, which numba types as a literal."""
    del folder
    at = decorator(_at)

    def difference(a: Array) -> float:
        return float(at(a, 2) - at(a, 0))

    assert jit.kernel(difference)(np.array([1.0, 2.0, 4.0])) == 3.0
    assert len(at.dispatcher.signatures) == 1
