"""Import a model file once, in the worker of an engine."""

from __future__ import annotations

from pathlib import Path

from bodycheck.adapters.importers import (
    CONFIGURATIONS,
    ImportedLink,
    ImportRequest,
    MassMatrices,
    imported_link,
    matrices_of,
)
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.adapters.workers.protocol import Message
from bodycheck.scenarios.model_files.model_file import Format
from bodycheck.scenarios.model_files.rewriting import text_without_meshes
from bodycheck.scenarios.model_files.xml_file import read_bytes


def import_request(path: Path, form: Format, flags: str) -> ImportRequest:
    """Return the request to import a file."""
    return ImportRequest(str(path.absolute()), form, flags, text_without_meshes(read_bytes(path), form))


def import_once(
    pool: EnginePool, engine: str, request: ImportRequest, timeout_s: float
) -> tuple[list[ImportedLink], str, str]:
    """Return the links of an import, its outcome and its message; a lost worker is an outcome too."""
    answer = pool.ask(engine, {"do": "import", "import": request.__dict__}, timeout_s)
    if answer.get("outcome") != "ok":
        return [], str(answer.get("outcome")), str(answer.get("message", ""))
    try:
        return _links_of(answer), "ok", ""
    except (KeyError, TypeError, ValueError) as error:
        return [], "failed", f"an answer that is not a list of links: {error}"


def matrices_once(
    pool: EnginePool, engine: str, request: ImportRequest, timeout_s: float
) -> tuple[list[MassMatrices], str]:
    """Return the mass matrices of an import at random configurations, and why there are none."""
    message = {"do": "import", "import": request.__dict__, "matrices": CONFIGURATIONS}
    answer = pool.ask(engine, message, timeout_s)
    if answer.get("outcome") != "ok":
        return [], str(answer.get("message") or answer.get("outcome"))
    try:
        return [matrices_of(plain) for plain in answer["matrices"]], ""
    except (KeyError, TypeError, ValueError) as error:
        return [], f"an answer without mass matrices: {error}"


def _links_of(answer: Message) -> list[ImportedLink]:
    links = [imported_link(plain) for plain in answer["links"]]
    if not all(-1 <= link.parent < index for index, link in enumerate(links)):
        raise ValueError("a link stands before its parent")
    return links
