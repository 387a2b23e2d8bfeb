"""Write the corrected numbers of certain findings into a copy of a URDF, and nothing else."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.files import write_file
from bodycheck._util.formatting import names
from bodycheck.audit.audit import Audit, LintFinding
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.exact_arithmetic import doubles
from bodycheck.scenarios.model_files.urdf_mistakes import MOMENTS
from bodycheck.scenarios.model_files.xml_file import read_bytes


def with_fix(audit: Audit, model: Path, out: Path) -> Audit:
    """Return an audit with a note on what was written to `out`.

    Raises InputError if the file is no URDF, or if its text cannot be changed without changing other links.
    """
    if audit.format != "urdf":
        raise InputError(f"--fix: writes URDF, not {audit.format}")
    certain = {
        one.link: one
        for one in audit.findings
        if one.confidence == "certain" and one.inertia_kg_m2 is not None
    }
    if not certain:
        note = f"Nothing written to {out}: no certain finding has corrected numbers."
        return replace(audit, notes=(*audit.notes, note))
    content = with_inertials(
        read_bytes(model), {name: Inertial(one.inertia_kg_m2, one.centre_m) for name, one in certain.items()}
    )
    write_file(out, content)
    try:
        _check(model, out, certain)
    except InputError:
        out.unlink()
        raise
    note = f"Written to {out}: the corrected numbers of {names(list(certain))}."
    return replace(audit, notes=(*audit.notes, note))


def _check(model: Path, out: Path, certain: dict[str, LintFinding]) -> None:
    """Raise InputError unless the new file states the corrected numbers, and the old ones of other links."""
    before, after = read_model(model), read_model(out)
    for old, new in zip(before.links, after.links, strict=True):
        finding = certain.get(old.name)
        if old.stated is None or new.stated is None:
            same = old.stated is new.stated
        else:
            tensor = doubles(old.stated.inertia.tensor)[np.triu_indices(3)].tolist()
            expected = tensor if finding is None else list(finding.inertia_kg_m2 or ())
            same = doubles(new.stated.inertia.tensor)[np.triu_indices(3)].tolist() == expected
        if not same:
            raise InputError(f"--fix: the text of link {old.name!r:.80} in {model} cannot be changed")


_TOKEN = re.compile(
    rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<[?!][^>]*>"
    rb"|<(?P<end>/?)(?P<tag>[^\s/>]+)(?P<attributes>(?:[^<>\"']|\"[^\"]*\"|'[^']*')*?)(?P<empty>/?)>",
    re.DOTALL,
)


@dataclass(frozen=True)
class Inertial:
    """New numbers: xx, xy, xz, yy, yz, zz in kg m^2, and the centre (3,) in m; None: it stays."""

    inertia_kg_m2: Sequence[float] | None
    centre_m: Sequence[float] | None


def with_inertials(content: bytes, changes: Mapping[str, Inertial]) -> bytes:
    """Return a URDF whose links, link -> inertial, have other tensors and centres of mass."""
    edits: list[tuple[int, int, bytes]] = []
    for name, path, token in _tags(content):
        change = changes.get(name)
        if change is None:
            continue
        if path == (b"robot", b"link", b"inertial", b"inertia") and change.inertia_kg_m2 is not None:
            order = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            values = dict(zip(order, map(repr, change.inertia_kg_m2), strict=True))
            edits.append(_edit(token, {name: values[name] for _, _, name in MOMENTS}))
        elif path == (b"robot", b"link", b"inertial", b"origin") and change.centre_m is not None:
            edits.append(_edit(token, {"xyz": " ".join(map(repr, change.centre_m))}))
    for start, end, text in sorted(edits, reverse=True):
        content = content[:start] + text + content[end:]
    return content


def _tags(content: bytes) -> Iterator[tuple[str, tuple[bytes, ...], re.Match[bytes]]]:
    """Yield each start tag, with the name of its link and its path of tags."""
    path: list[bytes] = []
    link = ""
    for token in _TOKEN.finditer(content):
        tag = token["tag"]
        if tag is None:
            continue
        if token["end"]:
            if path:
                path.pop()
            continue
        path.append(tag)
        if len(path) == 2:
            named = re.search(rb"\bname\s*=\s*(?:\"([^\"]*)\"|'([^']*)')", token["attributes"])
            link = "" if named is None else (named[1] or named[2] or b"").decode(errors="replace")
        yield link, tuple(path), token
        if token["empty"]:
            path.pop()


def _edit(token: re.Match[bytes], values: Mapping[str, str]) -> tuple[int, int, bytes]:
    """Return the start, end and new text of a tag's attributes; those that it lacks come last."""
    text = token["attributes"]
    for name, value in values.items():
        pattern = re.compile(rb"(\b" + name.encode() + rb"\s*=\s*)(\"[^\"]*\"|'[^']*')")
        new = value.encode()
        text, found = pattern.subn(lambda one, new=new: one[1] + b'"' + new + b'"', text, count=1)
        if not found:
            text += b" " + name.encode() + b'="' + new + b'"'
    return token.start("attributes"), token.end("attributes"), text
