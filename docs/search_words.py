"""A Sphinx extension: words that readers search for and pages do not use, and the names of options.

The comment <!-- search: hang, stuck --> below a heading makes these words lead to its section. Viewers of the
repository do not show it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.domains.std import StandardDomain

_COMMENT = re.compile(r"<!-- search: (.+) -->")


def make_entries(sphinx: Sphinx, document: nodes.document) -> None:
    """Replace each comment by entries of the index, which the search finds before all others."""
    del sphinx
    for comment in list(document.findall(nodes.raw)):
        if found := _COMMENT.fullmatch(comment.astext().strip()):
            section: Any = comment.parent
            words = found[1].split(", ")
            entries = [("single", word, section["ids"][0], "main", None) for word in words]
            comment.replace_self(addnodes.index(entries=entries))


class NamedOptions(StandardDomain):
    """The domain of options, which the search shows as "bodycheck run --timeout-s"."""

    def get_objects(self) -> Iterator[tuple[str, str, str, str, str, int]]:
        """Yield all objects, with options named by the title of their page."""
        for name, shown, kind, page, anchor, priority in super().get_objects():
            if kind == "cmdoption":
                shown = f"{self.env.titles[page].astext()} {name.partition('.')[2]}"
            yield name, shown, kind, page, anchor, priority


def setup(sphinx: Sphinx) -> dict[str, Any]:
    """Read the comments of each page, and replace the domain of options."""
    sphinx.connect("doctree-read", make_entries)
    sphinx.add_domain(NamedOptions, override=True)
    return {"parallel_read_safe": True}
