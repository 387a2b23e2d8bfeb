"""Change the numbers of inertials in the text of a URDF, and leave every other byte as it is."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from bodycheck.scenarios.model_files.urdf import MOMENTS

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
