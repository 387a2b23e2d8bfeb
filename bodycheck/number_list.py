"""Numbers as the command line takes them: 1e-2,1e-3."""

from __future__ import annotations

from bodycheck.errors import InputError


def numbers(text: str | None, option: str) -> list[float] | None:
    """Return the numbers of a comma-separated list; None where there is no list.

    Raises InputError, which names the option, for a word that is no number.
    """
    if text is None:
        return None
    found = []
    for word in text.split(","):
        try:
            found.append(float(word))
        except ValueError:
            raise InputError(
                f"{option} {text}: {word.strip()!r} is not a number; give numbers like 1e-2,1e-3"
            ) from None
    return found
