"""Attitude Ephemeris Messages of CCSDS (504.0-B-1 and B-2), in keyword-value notation.

A quaternion of frame A to B, (cos, e sin) of the half angle, rotates the axes of A onto those of B: it takes
vectors from B to A. Angles rotate about the axes of the body in their order; both are in degrees.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import names
from bodycheck._util.untrusted import printable
from bodycheck.recordings.recording import Recording
from bodycheck.recordings.resolution import iso_seconds

BEGINS = b"CCSDS_AEM_VERS"
"""The first word of a message."""

_BODY = re.compile(r"SC_BODY|ACC|AST|CSS|DSS|ESA|GYRO|IMU|INSTRUMENT|MTA|PRISM|RW|SA|SENSOR|STARTRACKER|TAM")
_QUATERNIONS = ("QUATERNION", "QUATERNION/DERIVATIVE", "QUATERNION/ANGVEL")
_ANGLES = ("EULER_ANGLE", "EULER_ANGLE/DERIVATIVE", "EULER_ANGLE/ANGVEL")
_KEYWORD = re.compile(r"([A-Z_0-9]+)\s*=\s*(.*)")
_TIME = "EPOCH"


@dataclass(frozen=True)
class _Segment:
    """The keywords of the metadata of a segment, and the lines of its data: (number, cells)."""

    keywords: Mapping[str, str]
    rows: list[tuple[int, list[str]]]


def read_aem(path: Path, content: bytes) -> Recording:
    """Return the epochs, attitudes and angular velocities of a message of one segment, with their map.

    Raises InputError where a keyword is missing without which the attitude has no meaning.
    """
    try:
        text = content.decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text in UTF-8") from None
    header, segments = _segments(text)
    if len(segments) != 1:
        raise InputError(f"{path}: has {len(segments)} segments of data, not one")
    keywords = {**header, **segments[0].keywords}
    rows = segments[0].rows
    columns, described = _described(path, keywords)
    for number, cells in rows:
        if len(cells) < len(columns):
            needed = ", ".join(columns)
            raise InputError(f"{path}: line {number}: has {len(cells)} values, expected {needed}")
    found = {name: [cells[index] for _, cells in rows] for index, name in enumerate(columns)}
    return Recording(path, found, len(rows), lambda row: f"line {rows[row][0]}", described=described)


def _segments(text: str) -> tuple[dict[str, str], list[_Segment]]:
    header: dict[str, str] = {}
    keywords = header
    segments: list[_Segment] = []
    for number, line in enumerate(map(str.strip, text.splitlines()), 1):
        if line == "META_START":
            keywords = {}
            segments.append(_Segment(keywords, []))
        elif found := _KEYWORD.fullmatch(line):
            keywords[found[1]] = found[2].strip()
        elif segments and line and iso_seconds(line.split()[0]) is not None:
            segments[-1].rows.append((number, line.split()))
    return header, segments


def _described(path: Path, keywords: Mapping[str, str]) -> tuple[list[str], dict[str, Any]]:
    """Return the columns of the data, and the map that the keywords state."""
    is_first_issue = keywords.get("CCSDS_AEM_VERS", "").startswith("1")
    kind = keywords.get("ATTITUDE_TYPE", "").upper()
    needed = ["ATTITUDE_TYPE", "REF_FRAME_A", "REF_FRAME_B"]
    needed += ["ATTITUDE_DIR"] * is_first_issue + ["QUATERNION_TYPE"] * (
        is_first_issue and kind in _QUATERNIONS
    )
    needed += ["EULER_ROT_SEQ"] * (kind in _ANGLES) + ["ANGVEL_FRAME"] * kind.endswith("/ANGVEL")
    if missing := [keyword for keyword in needed if not keywords.get(keyword)]:
        raise InputError(f"{path}: lacks {names(missing)}, without which its attitude has no meaning")
    if kind not in (*_QUATERNIONS, *_ANGLES):
        accepted = ", ".join((*_QUATERNIONS, *_ANGLES))
        raise InputError(f"{path}: ATTITUDE_TYPE = {printable(kind, 40)}: is not read; expected {accepted}")
    described: dict[str, Any] = {"t_s": _TIME, "time_origin": "first-sample", "ignore": ["*"]}
    described["attitude"] = _direction(path, keywords)
    if kind in _QUATERNIONS:
        parts = [f"q{part}" for part in "xyz"]
        is_scalar_first = keywords.get("QUATERNION_TYPE", "LAST").upper() == "FIRST"
        columns = ["qw", *parts] if is_scalar_first else [*parts, "qw"]
        described |= {name: name for name in columns}
    else:
        columns = ["ANGLE_1", "ANGLE_2", "ANGLE_3"]
        described |= {f"euler_{name[-1]}_rad": f"{name}*deg" for name in columns}
        described["euler"] = "".join(
            "XYZ"[int(c) - 1] if c in "123" else c for c in keywords["EULER_ROT_SEQ"]
        )
    columns = [_TIME, *columns]
    if kind.endswith("/ANGVEL"):
        axes = "body" if _is_body(keywords["ANGVEL_FRAME"]) else "world"
        columns += [f"ANGVEL_{axis}" for axis in "XYZ"]
        described |= {f"w{axis}_{axes}_rad_s": f"ANGVEL_{axis.upper()}*deg/s" for axis in "xyz"}
    return columns, described


def _direction(path: Path, keywords: Mapping[str, str]) -> str:
    """Return which way the attitude rotates; raises InputError where not one of the frames is the body's."""
    frames = [keywords["REF_FRAME_A"], keywords["REF_FRAME_B"]]
    body_first, body_second = map(_is_body, frames)
    direction = keywords.get("ATTITUDE_DIR", "A2B").upper()
    if body_first == body_second or direction not in ("A2B", "B2A"):
        stated = f"REF_FRAME_A = {frames[0]}, REF_FRAME_B = {frames[1]}, ATTITUDE_DIR = {direction}"
        raise InputError(f"{path}: {printable(stated, 120)}: one frame must be the body's, like SC_BODY_1")
    return "body-to-world" if body_second == (direction == "A2B") else "world-to-body"


def _is_body(frame: str) -> bool:
    return _BODY.match(frame.upper()) is not None
