"""How Sphinx builds the documentation: sphinx-build -W --keep-going docs docs/_build."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version as version_of
from pathlib import Path

from sphinx.search.en import SearchEnglish

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]  # extensions, census
os.environ["NUMBA_DISABLE_JIT"] = "1"  # kernels are then plain functions, whose signatures autodoc can read

project = "bodycheck"
author = "The bodycheck developers"
project_copyright = f"2026, {author}"
version = release = version_of("bodycheck")

SearchEnglish.stopwords |= {"s"}  # the unit of options such as --timeout-s, which every page has

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "formulas",
    "generated_pages",
    "plain_docstrings",
    "search_words",
    "sphinx_copybutton",
]
copybutton_prompt_text = "$ "  # of console blocks, of which only the commands are copied
smartquotes = False  # options begin with two hyphens, and are copied
html_math_renderer = "mathml"
# little, because the pages are read in the repository too, where a viewer knows no more
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "templates"]

html_theme = "furo"
html_title = "bodycheck"
html_static_path = ["static"]
html_use_index = False  # the search has its entries
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
templates_path = ["templates"]

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"Array": "Array"}
