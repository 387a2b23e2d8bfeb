"""What is told of a night, in sentences."""

from __future__ import annotations

from bodycheck.reports.comparison.release_search import release_searches
from bodycheck.reports.comparison.words import sentences
from bodycheck.reports.history.judgement import Judgement
from bodycheck.reports.history.levels import LEAST_AFTER, LEAST_BEFORE, least_told, usual_spread
from bodycheck.reports.history.machine_class import machine_class
from bodycheck.reports.wording import count, number
from bodycheck.reports.worst_results import faulty, worst_methods
from bodycheck.reports.worst_results import headline as methods_headline

_HEADLINES = {
    "regression": "Regression: something became worse, or is not measured any more.",
    "no regression": "No regression.",
    "nothing measured": "No case ended well: nothing was measured.",
    "past too thin": "The past is too thin: no run on a machine like this one has cases to compare with.",
}


def headline(judged: Judgement) -> str:
    """Return the status in one sentence."""
    return _HEADLINES[judged.status]


def night_sentences(judged: Judgement) -> list[str]:
    """Return what was compared, how much changed, how far speed can be judged, and what was left out."""
    found: list[str] = []
    if judged.comparison is not None:
        searches = release_searches(judged.comparison)
        found = [*sentences(judged.comparison), *(f"To find the release: {command}" for command in searches)]
        found += [
            f"Compared with the levels accepted after the nightly run {judged.comparison.before.run_id}."
        ]
    found += _findings(judged)
    found += [_speed_sentence(judged), f"Machine: {machine_class(judged.tonight.manifest)}."]
    found += [f"A night that cannot be read was left out: {why}." for why in judged.past.left_out]
    return found


def _findings(judged: Judgement) -> list[str]:
    """Return what the run itself has against its methods, as its report words it, changed or not."""
    wrong = faulty(worst_methods(judged.tonight))
    lines = [f"{one.method}: {one.sentence}. To see it again: {one.worst.reproduce}" for one in wrong]
    return [methods_headline(wrong), *lines] if wrong else []


def _speed_sentence(judged: Judgement) -> str:
    speeds, least = judged.speeds.series, LEAST_BEFORE + LEAST_AFTER
    if not judged.tonight.manifest["speed"]:
        return "Speed was not measured."
    if speeds.measured < least:
        return (
            f"Speed is not judged yet: it was measured on {speeds.measured} of the {least} nights that takes."
        )
    spread = usual_spread(speeds.decades, list(judged.speeds.steps.values()))
    percent = 100.0 * (10.0 ** least_told(spread) - 1.0)
    told = f"a method that takes {number(percent, 2)} % longer is told within five nights"
    return f"Speed is judged by {count(speeds.measured, 'night')}: {told}."
