"""Reading .npz files of any program: the sizes that they declare are checked before anything is allocated."""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from bodycheck.errors import InputError
from bodycheck.reference_impl.arrays import Array

_MOST_BYTES = 1 << 28
"""Of all arrays together, as doubles: the quantities of a million samples take 208 MB."""
_ALWAYS_BYTES = 1 << 25
_MOST_PACKED = 50  # times the file's size, beyond that: what is packed closer is a trap, or at rest
_DOUBLE_BYTES = 8
_MOST_DIMENSIONS = 3
_EXACT = 2**53  # up to here every whole number is a double
_ENCRYPTED = 0x1
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what numpy writes


def read_npz(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Return the arrays of these names that the file has, as doubles.

    Raises OSError where the file cannot be read, InputError with one line where it is no npz of real numbers.
    """
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            left = min(_MOST_BYTES, max(_ALWAYS_BYTES, _MOST_PACKED * path.stat().st_size))
            arrays = {}
            for name in names:
                if f"{name}.npy" in archive.NameToInfo:
                    arrays[name] = _array(archive, name, left)
                    left -= arrays[name].nbytes
            return arrays
    except (ValueError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: is not an npz of numbers: {' '.join(str(error).split())}") from None


def _array(archive: zipfile.ZipFile, name: str, most: int) -> Array:
    """Return one member of at most so many bytes as doubles.

    Raises ValueError where its header and its size do not agree, or it has no real numbers.
    """
    member = archive.getinfo(f"{name}.npy")
    if member.flag_bits & _ENCRYPTED:
        raise ValueError(f"{name} is encrypted")
    if member.compress_type not in _METHODS:
        raise ValueError(f"{name} is packed in a way that numpy does not write; use numpy.savez")
    with archive.open(member) as packed:
        stream = cast(BinaryIO, packed)
        shape, columns_first, dtype = _header(stream, name, most)
        size = math.prod(shape) * dtype.itemsize
        content = stream.read(size + 1)
    if len(content) != size:
        raise ValueError(f"{name} has the shape {shape} of {dtype}, but {len(content)} bytes, not {size}")
    values = np.frombuffer(content, dtype).reshape(shape, order="F" if columns_first else "C")
    return doubles(np.ascontiguousarray(values), name)


def _header(stream: BinaryIO, name: str, most: int) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, order and type of an array, of numbers, as doubles of at most so many bytes."""
    version = np.lib.format.read_magic(stream)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read is None:
        raise ValueError(f"{name} is of the npy version {version}")
    shape, columns_first, dtype = read(stream)
    if dtype.kind not in "fiu":
        raise ValueError(f"{name} is of {dtype}, not of real numbers")
    if dtype.itemsize > _DOUBLE_BYTES:
        raise ValueError(f"{name} is of {dtype}, which no double holds in full")
    if len(shape) > _MOST_DIMENSIONS or min(shape, default=0) < 0:
        raise ValueError(f"{name} has the shape {shape}")
    if math.prod(shape) * _DOUBLE_BYTES > most:
        raise ValueError(f"{name} declares the shape {shape}: more than the {most} bytes that are read of it")
    return shape, columns_first, dtype


def doubles(values: np.ndarray[Any, np.dtype[Any]], name: str) -> Array:
    """Return real numbers as doubles; ValueError for a whole number that no double holds in full."""
    whole = values.dtype.kind in "iu" and values.size
    if whole and max(int(values.max()), -int(values.min())) > _EXACT:
        raise ValueError(f"{name} has whole numbers above 2^53, which no double holds in full")
    return values.astype(np.float64)
