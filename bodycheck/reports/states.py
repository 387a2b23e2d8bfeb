"""What a method can come to on a scenario: every verdict, and every outcome of a case but ok, in words."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class State:
    """What a cell can say: its symbol, its word, what it means, and the tint that it shares with others."""

    symbol: str
    word: str
    meaning: str
    tint: str


STATES = {
    "converges": State("✓", "converges", "ever finer steps lead to the truth, in every quantity", "good"),
    "at-floor": State("≈", "at floor", "all errors lie at round-off or at the truth's own bound", "floor"),
    "exact": State("=", "exact", "a method without steps, at the truth's own bound", "floor"),
    "pre-asymptotic": State(
        "…", "pre-asymptotic", "errors too large or too irregular for an order to show", "open"
    ),
    "lower-order": State(
        "↓", "lower order", "the error shrinks, at a lower order than the method has in theory", "open"
    ),
    "too-few-points": State("?", "too few points", "fewer than four steps with a usable error", "open"),
    "chaotic": State("≋", "chaotic", "nearby motions part too fast for an error to mean much", "open"),
    "does-not-converge": State(
        "✗", "does not converge", "ever finer steps lead to something else than the truth", "bad"
    ),
    "off": State("✗", "no steps, off", "a method without steps, above the truth's own bound", "bad"),
    "unstable": State(
        "▲", "unstable", "not finite, not a rotation, or 100 times the true kinetic energy", "fault"
    ),
    "failed": State("!", "failed", "the engine raised an error", "fault"),
    "timeout": State("!", "timeout", "the case took longer than it was given", "fault"),
    "invalid": State("≠", "invalid", "the engine held other parameters than it was given", "fault"),
    "unsupported": State("○", "unsupported", "the method cannot represent the scenario", "none"),
}
"""Every verdict of methods.csv and every outcome but ok, with words for what neither of them says."""

FAULTS = ("invalid", "failed", "timeout", "unstable")
"""The outcomes of cases that did not end well, the gravest first."""

UNDECIDED = 1
"""The severity of a verdict that neither confirms nor accuses."""

_SEVERITIES = {"good": 0, "floor": 0, "open": UNDECIDED, "none": UNDECIDED, "bad": 2, "fault": 3}
"""Tint -> how severe the states of that tint are."""


def severity(word: str) -> int:
    """Return how severe a verdict is: 0 sound, 1 undecided, 2 wrong, 3 broken; an unknown word: 1."""
    return _SEVERITIES[STATES[word].tint] if word in STATES else UNDECIDED
