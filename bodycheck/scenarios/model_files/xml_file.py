"""Parse XML without entities, without a network and without any other file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lxml import etree

from bodycheck._util import untrusted
from bodycheck._util.errors import InputError
from bodycheck._util.formatting import unread
from bodycheck._util.untrusted import printable
from bodycheck.scenarios.model_files.exact_arithmetic import finite, words_of

_MAX_BYTES = 1 << 26
_DECLARATION = re.compile(rb"\s*<\?xml\b[^>]*\?>")
_NOT_MARKUP = re.compile(rb"<!--|<!\[CDATA\[")
_DEEPEST = 200  # engines recurse, and so do readers


def parse_xml(path: Path) -> Any:
    """Return the root element of a file; raises InputError with one line: file, line, what is wrong."""
    return parse_text(read_bytes(path), str(path))


def read_bytes(path: Path) -> bytes:
    """Return the content of a model file; raises InputError with one line if it cannot be read."""
    try:
        return untrusted.read_bytes(path, _MAX_BYTES)
    except OSError as error:
        raise InputError(unread(path, error)) from None


def repaired(content: bytes) -> bytes:
    """Return a document as engines accept it: no comments, declaration, surrounding blanks, final NUL bytes.

    All lines keep their numbers. Files with version="0.0", a blank or a comment before the declaration, or
    two hyphens in a comment are common.
    """
    content = _without_comments(content.removeprefix(b"\xef\xbb\xbf").rstrip(b" \t\r\n\0"))
    found = _DECLARATION.match(content)
    if found is None or re.search(rb"encoding\s*=\s*[\"'](?!utf-8|us-ascii)", found[0], re.IGNORECASE):
        return content
    return b"\n" * found[0].count(b"\n") + content[found.end() :]


def _without_comments(content: bytes) -> bytes:
    """Return a document whose comments are replaced by their line ends; what does not end stays as it is."""
    kept, at = [], 0
    while found := _NOT_MARKUP.search(content, at):
        ending = b"-->" if found[0] == b"<!--" else b"]]>"
        end = content.find(ending, found.end())
        if end < 0:
            break
        comment = content[found.start() : end + len(ending)]
        kept += [content[at : found.start()], b"\n" * comment.count(b"\n") if ending == b"-->" else comment]
        at = end + len(ending)
    return b"".join([*kept, content[at:]])


def parse_text(content: bytes, where: str) -> Any:
    """Return the root element of a file's content; `where` names it in messages.

    A name with a prefix that no element declares keeps the prefix: XML 1.0 and engines know no namespaces.
    """
    text = repaired(content)
    try:
        parser = _parser(recover=False)
        try:
            root = etree.fromstring(text, parser)
        except etree.XMLSyntaxError:
            if any(one.domain != etree.ErrorDomains.NAMESPACE for one in parser.error_log):
                raise
            root = etree.fromstring(text, _parser(recover=True))
    except etree.XMLSyntaxError as error:
        line = f":{error.lineno}" if error.lineno else ""
        raise InputError(f"{where}{line}: is not XML: {printable(str(error.msg), 200)}") from None
    except ValueError as error:
        raise InputError(f"{where}: is not XML: {printable(str(error), 200)}") from None
    declared = root.getroottree().docinfo.internalDTD
    if declared is not None and any(True for _ in declared.iterentities()):
        raise InputError(f"{where}: declares entities, which are not expanded; write their text instead")
    _check_depth(root, where)
    return root


def _parser(*, recover: bool) -> Any:
    return etree.XMLParser(
        recover=recover,
        resolve_entities=False,
        load_dtd=False,
        no_network=True,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
    )


def _check_depth(root: Any, where: str) -> None:
    level, depth = [root], 0
    while level:
        depth += 1
        if depth > _DEEPEST:
            raise InputError(f"{where}:{level[0].sourceline}: is nested deeper than {_DEEPEST} elements")
        level = [child for element in level for child in element]


class Node:
    """An element of a file, whose attributes are read with messages that name file and line."""

    def __init__(self, element: Any, file: Path) -> None:
        self.element, self.file = element, file

    @property
    def tag(self) -> str:
        """The name of the element without a namespace."""
        return str(self.element.tag).rpartition("}")[2]

    @property
    def line(self) -> int:
        """The line of the element in its file."""
        return int(self.element.sourceline or 0)

    @property
    def where(self) -> str:
        """FILE:LINE: <TAG>."""
        return f"{self.file}:{self.line}: <{self.tag}>"

    def __contains__(self, name: str) -> bool:
        return name in self.element.attrib

    def children(self, *tags: str) -> Iterator[Node]:
        """Yield the children with one of these tags; all children if none is given."""
        for child in self.element:
            if isinstance(child.tag, str):
                node = Node(child, self.file)
                if not tags or node.tag in tags:
                    yield node

    def child(self, tag: str) -> Node | None:
        """Return the first child with this tag."""
        return next(self.children(tag), None)

    def text(self, name: str, default: str | None = None) -> str:
        """Return an attribute; raises InputError if it is missing and has no default."""
        found = self.element.get(name, default)
        if found is None:
            raise InputError(f"{self.where}: has no attribute {name!r}")
        return str(found)

    def numbers(self, name: str, count: int | None = None, default: str | None = None) -> list[float]:
        """Return the numbers of an attribute; raises InputError if they are not `count` finite numbers."""
        text = self.text(name, default)
        try:
            return finite(text, count)
        except ValueError as error:
            raise InputError(f"{self.where}: {name} = {error}") from None

    def leading(self, name: str, count: int, default: str) -> list[float]:
        """Return the first `count` numbers, as engines do where there are more."""
        words = words_of(self.text(name, default))
        try:
            return finite(" ".join(words[:count]), count)
        except ValueError as error:
            raise InputError(f"{self.where}: {name} = {error}") from None

    def number(self, name: str, default: float | None = None) -> float:
        """Return a number; raises InputError if it is missing without a default, or not finite."""
        if name not in self and default is not None:
            return default
        return self.numbers(name, 1)[0]
