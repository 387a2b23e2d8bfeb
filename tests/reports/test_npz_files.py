"""Trajectories of other programs: sizes are checked before allocation, and no number is rounded."""

from __future__ import annotations

import io
import random
import tracemalloc
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.run_files.trajectory_files import npz, read_arrays, read_npz
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.file_mutations import npz_member

T_S = np.linspace(0.0, 1.0, 11)
GOOD = {"t_s": T_S, "position_m": np.zeros((11, 3))}


def member(header: str, content: bytes = bytes(88)) -> bytes:
    """Return an npy file with exactly this header."""
    head = header.ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + content


def archive(content: bytes, method: int = zipfile.ZIP_STORED) -> bytes:
    """Return an npz whose t_s is this npy file."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", method) as made:
        made.writestr("t_s.npy", content)
    return whole.getvalue()


def shaped(shape: str, kind: str = "<f8") -> bytes:
    """Return an npz whose t_s declares this shape and type."""
    return archive(member(f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"))


def bomb() -> bytes:
    """Return an npz of less than 1 MB whose t_s truly has 64 MB."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as made, made.open("t_s.npy", "w") as stream:
        stream.write(member("{'descr': '<f8', 'fortran_order': False, 'shape': (8000000,), }", b""))
        for _ in range(8):
            stream.write(bytes(8_000_000))
    return whole.getvalue()


def saved(values: Any) -> bytes:
    """Return an npz whose t_s numpy wrote."""
    whole = io.BytesIO()
    np.savez(whole, t_s=values)
    return whole.getvalue()


def encrypted() -> bytes:
    """Return an npz whose only member is flagged as encrypted."""
    content = bytearray(saved(T_S))
    content[6] |= 1
    content[content.index(b"PK\x01\x02") + 8] |= 1
    return bytes(content)


REFUSED = {
    "a shape without end": (shaped("(1000000000000,)"), "t_s declares the shape"),
    "a shape beyond all integers": (shaped("(99999999999999999999999, 4)"), "t_s declares the shape"),
    "a negative shape": (shaped("(-1,)"), "t_s has the shape"),
    "more than it has": (shaped("(12,)"), "but 88 bytes, not 96"),
    "less than it has": (shaped("(10,)"), "bytes, not 80"),
    "five dimensions": (shaped("(11, 1, 1, 1, 1)"), "t_s has the shape"),
    "complex numbers": (saved(T_S + 1j), "has type complex128, not real numbers"),
    "a structure": (saved(np.zeros(11, "f8,i4")), "not real numbers"),
    "text": (saved(np.full(11, "1.0")), "not real numbers"),
    "more than a double": (saved(T_S.astype(np.longdouble)), "which does not fit in doubles"),
    "whole numbers beyond a double": (saved(np.arange(11) + 2**60), "which do not fit in doubles"),
    "objects": (saved(np.array([None, 1.0], dtype=object)), "has type object, not real numbers"),
    "encrypted": (encrypted(), "t_s is encrypted"),
    "another packing": (archive(member(""), zipfile.ZIP_LZMA), "t_s has an unsupported compression"),
    "a bomb": (bomb(), "t_s declares the shape"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_invalid_npz_is_refused_before_allocation(
    what: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """One line names the file and the error; no more memory is used than the file has."""
    path = tmp_path / "judged.npz"
    content, why = REFUSED[what]
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with expected_message.raises(InputError) as refused:
            read_arrays(path)
        assert tracemalloc.get_traced_memory()[1] < 4_000_000
    finally:
        tracemalloc.stop()
    assert why in str(refused.value)
    assert str(refused.value).startswith(f"{path}: ")


@pytest.mark.parametrize("kind", ["<f8", ">f8", "<f4", "<i4", "u1"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npz_of_real_numbers_is_read_as_by_numpy(kind: str, order: Any, tmp_path: Path) -> None:
    """Arrays of any type, byte order and order of axes are read, compressed or not."""
    values = np.asarray(np.arange(33).reshape(11, 3), dtype=kind, order=order)
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", t_s=values)
        found = read_npz(tmp_path / "a.npz", ["t_s", "quaternion"])
        assert list(found) == ["t_s"]
        np.testing.assert_array_equal(found["t_s"], values)
        assert found["t_s"].dtype == np.dtype(kind).newbyteorder("=")


def test_mutated_npz_is_read_or_refused(tmp_path: Path) -> None:
    """Sixty seeded mutations of a valid file cause an InputError or none."""
    sound, path = npz(GOOD), tmp_path / "judged.npz"
    for seed in range(60):
        path.write_bytes(npz_member(sound, random.Random(seed)))
        with suppress(InputError):
            read_arrays(path)
