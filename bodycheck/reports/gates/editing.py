"""A tolerance file with some of its bounds replaced: all else in it, comments too, stays as it was."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

from bodycheck.errors import InputError
from bodycheck.reports.gates.gate import Gate, parse_gates
from bodycheck.reports.gates.proposal import Change
from bodycheck.reports.wording import step

_HEADER = re.compile(r"^[ \t]*\[\[[ \t]*gate[ \t]*\]\]", flags=re.MULTILINE)
_STRING = r'"(?:[^"\\\n]|\\.)*"|' + r"'[^'\n]*'"


def edited(text: str, where: str, changes: Sequence[Change], why: str | None) -> str:
    """Return the text of a tolerance file with the changes made, and read again to be sure of them.

    why: what is added, once, to the reason of a gate that is loosened. Raises InputError where a bound does
    not stand on a line of its own under its [[gate]].
    """
    before = parse_gates(text, where)
    starts = [found.start() for found in _HEADER.finditer(text)]
    parts = [text[a:b] for a, b in zip([0, *starts], [*starts, len(text)], strict=True)]
    wanted = list(before)
    for change in changes:
        gate = wanted[change.place]
        told: dict[str, object] = {change.key: change.new}
        lines: dict[str, tuple[str, str]] = {change.key: (r"[^\s#]+", step(change.new))}
        if change.loosens and why is not None and not gate.reason.endswith(added := f"; loosened: {why}"):
            told["reason"] = gate.reason + added
            lines["reason"] = (_STRING, json.dumps(told["reason"], ensure_ascii=False))
        wanted[change.place] = gate.model_copy(update=told)
        if change.place + 1 < len(parts):
            parts[change.place + 1] = _with_lines(parts[change.place + 1], lines)
    new = "".join(parts)
    if not _says(new, where, wanted):
        raise InputError(f"{where}: cannot be edited: write each key of a [[gate]] on one line of its own")
    return new


def _with_lines(table: str, lines: dict[str, tuple[str, str]]) -> str:
    for key, (old, new) in lines.items():
        line = re.compile(rf"^([ \t]*{key}[ \t]*=[ \t]*)(?:{old})", flags=re.MULTILINE)
        table = line.sub(lambda found, new=new: found[1] + new, table, count=1)  # type: ignore[misc]
    return table


def _says(text: str, where: str, wanted: Sequence[Gate]) -> bool:
    try:
        return list(parse_gates(text, where)) == list(wanted)
    except InputError:
        return False
