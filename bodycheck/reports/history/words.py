"""What is told of a night, in sentences."""

from __future__ import annotations

from bodycheck.reports.comparison.words import sentences
from bodycheck.reports.history.judgement import Judgement
from bodycheck.reports.history.levels import LEAST_AFTER, LEAST_BEFORE, least_told, usual_spread
from bodycheck.reports.history.machine_class import machine_class
from bodycheck.reports.wording import count, number

_HEADLINES = {
    "regression": "Regression: something became worse, or is not measured any more.",
    "no regression": "No regression.",
    "nothing measured": "No case ended well: nothing was measured.",
    "past too thin": "The past is too thin: no night on a machine like this one has cases to compare with.",
}


def headline(judged: Judgement) -> str:
    """Return the status in one sentence."""
    return _HEADLINES[judged.status]


def night_sentences(judged: Judgement) -> list[str]:
    """Return what was compared, how much changed, how far speed can be judged, and what was left out."""
    found = [f"Machine: {machine_class(judged.tonight.manifest)}."]
    if judged.comparison is not None:
        found.append(f"Compared with the night {judged.comparison.before.run_id}.")
        found += sentences(judged.comparison)
    found.append(_speed_sentence(judged))
    found += [f"A night that cannot be read was left out: {why}." for why in judged.past.left_out]
    return found


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
