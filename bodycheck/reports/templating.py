"""The templates of the HTML pages, and the static files that they include unchanged."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bodycheck._util import formatting


@cache
def environment() -> Environment:
    """Return the templates: what is put into them is escaped, what they lack is an error."""
    environment = Environment(
        loader=PackageLoader("bodycheck.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,  # otherwise each of a thousand includes checks the disk for changes
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.filters |= {
        "number": formatting.number,
        "scientific": formatting.scientific,
        "step": formatting.step,
        "unbroken": unbroken,
        "with_issues": with_issues,
    }
    environment.globals |= {"count": formatting.count, "css": asset("templates/report.css")}
    return environment


def rendered(template: str, *shared: Mapping[str, Any], **values: Any) -> str:
    """Return the HTML of a template with values, which it escapes."""
    return environment().get_template(template).render(*shared, **values)


def with_issues(text: str) -> Markup:
    """Return text whose references OWNER/PROJECT#NUMBER and https addresses are links; options stay whole."""
    link = '<a href="{}">{}</a>'
    parts = []
    end = 0
    for found in _LINKED.finditer(text):
        address = found[0] if found[1] is None else f"https://github.com/{found[1]}/issues/{found[2]}"
        parts += [unbroken(text[end : found.start()], _OPTION), Markup(link).format(address, found[0])]
        end = found.end()
    return Markup("").join([*parts, unbroken(text[end:], _OPTION)])


_WORD = r"(\S+[-/?=]\S+|--\S+)"
_OPTION = r"((?<!\S)--\S+)"


def unbroken(text: str, word: str = _WORD) -> Markup:
    """Return text that breaks at spaces only, as a command must; browsers break after hyphens as well.

    word: the pattern of what is kept whole, as one group.
    """
    kept, parts = Markup('<span class="whole">{}</span>'), re.split(word, text)
    return Markup("").join(kept.format(part) if k % 2 else part for k, part in enumerate(parts))


_LINKED = re.compile(r"\b([A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*)#(\d+)\b|https://[\w./#?=&%~+-]*[\w/]")


def asset(path: str) -> Markup:
    """Return a static file, ours or plotly's, to include unchanged in a page."""
    return Markup((files("bodycheck.reports") / path).read_text(encoding="utf-8"))
