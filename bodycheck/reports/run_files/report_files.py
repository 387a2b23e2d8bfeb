"""The files of a report: its first page, and the further pages of a large run in a folder next to it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.files import unfinished_name
from bodycheck._util.untrusted import open_input

_FURTHER = re.compile(r"[0-9]+\.html")
_MARK, _HEAD_BYTES = b"<title>bodycheck ", 2000


def further_pages(page: Path) -> Path:
    """Return the folder of the further pages of a report, whose first page is `page`."""
    return page.with_name(f"{page.stem}-files")


def write_pages(pages: Iterable[tuple[str, str]], folder: Path) -> None:
    """Write the pages of a report, each with its path, into a folder that is not a run yet."""
    for path, html in pages:
        file = folder / path
        file.parent.mkdir(exist_ok=True)
        file.write_text(html, encoding="utf-8")


def replace_pages(pages: Iterable[tuple[str, str]], page: Path) -> None:
    """Write a report to `page` and the folder of its further pages, in place of an earlier one.

    All pages are written under another name first. Raises InputError if they cannot be written, or if the
    folder has files that are not of a report.
    """
    folder = further_pages(page)
    unfinished = unfinished_name(page.absolute())
    try:
        unfinished.mkdir()
        try:
            write_pages(pages, unfinished)
            further = unfinished / folder.name
            if further.exists() and not _is_replaceable(folder):
                raise InputError(
                    f"{folder}: has other files than the pages of a report; move it, or name another page"
                )
            if folder.exists() and _is_replaceable(folder):
                folder.rename(unfinished / "former")
            if further.exists():
                further.rename(folder)
            (unfinished / page.name).replace(page)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{page}: cannot be written: {error.strerror or error}") from None


def _is_replaceable(folder: Path) -> bool:
    """Whether a folder is absent, or has nothing but pages of a report."""
    if folder.is_symlink() or not folder.is_dir():
        return not folder.exists()
    return all(_FURTHER.fullmatch(one.name) and _is_page(one) for one in folder.iterdir())


def _is_page(path: Path) -> bool:
    if path.is_symlink() or not path.is_file():
        return False
    with open_input(path) as file:
        return _MARK in file.read(_HEAD_BYTES)
