"""Cached engine answers and truths, and the journal of a run."""

from typing import Literal, TypeAlias

Reuse: TypeAlias = Literal["nothing", "truths", "installed", "everything"]
"""What is reused: nothing; the truths of scenarios; also the answers of installed engines; also those of all
other engines whose identity is known, including plug-ins and editable installs."""
