"""The conclusion about recordings: what is conserved, the distance from the truth, and the likely cause."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from bodycheck._util.formatting import count, names, number, scientific, step
from bodycheck.examine.diagnosis.candidate_maps import EXACT
from bodycheck.examine.diagnosis.diagnosis import ALL, Diagnosis
from bodycheck.examine.diagnosis.quantity_resolution import UNITS
from bodycheck.examine.explanation.explain import ExplainedCase
from bodycheck.examine.explanation.explanation_document import explanation_parts
from bodycheck.recordings.judge import Ranking
from bodycheck.recordings.judged_motion import (
    FROM_START,
    NEGLIGIBLE,
    QUANTITY_OF,
    TRAVELLING,
    TURNING,
    VAGUE,
    JudgedMotion,
    MomentumChange,
    is_free,
)
from bodycheck.recordings.wrong_rows import exceptions_of, is_right_elsewhere, without_exceptions
from bodycheck.reports.document import Document, Part, Sentence, Table
from bodycheck.reports.measurement.convergence import Convergence
from bodycheck.reports.measurement.measure_bounds import FLOOR_BOUNDS
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION, SIGNED, gain_word
from bodycheck.reports.render.styles import heading
from bodycheck.reports.table_layout import Column

_DIGITS = 3
_PER_CENT = 1e-4  # relative: from there on in per cent
_FEWEST_STEPS = 4
_AS_RESOLVED = ", as far as the file resolves it"
_MADE = ", which the noise of the first row can make"
_OF_TIME = 7  # digits, which tell the rows of long recordings apart
_BACK = 0.1  # of the largest error: a last row that is nearer agrees again
_FARTHER = 100.0  # of the error of omega, relative, to that of the attitude, where the latter is no cause
_NOT_NORMAL = {
    "quaternion_norm_error": "The quaternions are not normalised: |q| differs from 1",
    "orthogonality_error": "The matrices are not orthogonal: R^T R differs from the identity",
}
_ENERGIES = ("rotational_energy_drift", "energy_drift")


def conclusions(motion: JudgedMotion, case: ExplainedCase | None) -> list[Sentence]:
    """Return what was found about one recording: its error, the cause, what is conserved, what was assumed.

    case: None where it is not diagnosed.
    """
    diagnosis = None if case is None else case.diagnosis
    if not motion.case.ok:
        rows = [*_wrong_rows(motion)] or [f"{motion.name} is unstable: {motion.row['message']}."]
        return [Sentence(rows[0], "bad", strong=True), *map(Sentence, rows[1:])]
    is_wrong = diagnosis is not None and diagnosis.verdict == "explained"
    is_noisy = diagnosis is not None and diagnosis.is_within_noise and diagnosis.verdict == "healthy"
    of_noise = [] if diagnosis is None else [*_of_noise(motion, diagnosis)]
    distance = [*_distance(motion)]
    cause = [] if case is None else [*_cause(motion if motion.part is None else motion.part, case)]
    if wrong := [*_wrong_rows(motion)]:  # which are neither noise nor a motion
        unexplained = diagnosis is not None and diagnosis.verdict == "unexplained"
        is_only_noise = is_noisy and motion.part is None
        is_cause = not (is_only_noise or unexplained or is_right_elsewhere(motion))
        # the size and the rows themselves first; of rows that are late, the size stands in the distance
        parts = [*distance[:1], *wrong, *distance[1:]] if motion.repaired else [*wrong, *distance]
        parts += [*cause, *of_noise] if is_cause else ()
    elif is_noisy:  # which alone changes what is conserved
        parts = [*cause[::-1], *distance[::-1], *of_noise]
    else:
        parts = [*distance[:1], *cause, *distance[1:], *_conservation(motion), *of_noise]
    parts += _norms(motion)
    parts += _derived(motion)
    if motion.unused_position:
        has = motion.unused_position
        parts.append(f"The position is not compared, as the file has {has} with which it starts.")
    if motion.assumed:
        parts.append(f"Read with {motion.assumed}.")
    tint = "bad" if is_wrong else "good" if is_noisy or motion.is_true else "open"
    return [Sentence(text, tint if k == 0 else "none", strong=k == 0) for k, text in enumerate(parts)]


def conclusion(motion: JudgedMotion, case: ExplainedCase | None) -> str:
    """Return the conclusions as one text."""
    return " ".join(sentence.text for sentence in conclusions(motion, case))


def _derived(motion: JudgedMotion) -> Iterator[str]:
    """Yield what is not in the file, but derived from it."""
    if motion.without_omega:
        known_to = number(0.5 * motion.resolution.omega, 2)
        yield f"The file has {motion.without_omega}: it is derived from the attitudes, to {known_to} rad/s."


def _of_noise(motion: JudgedMotion, found: Diagnosis) -> Iterator[str]:
    """Yield what of the difference from the truth is noise, where the truth starts at a noisy row."""
    if not found.is_within_noise or motion.start != "first-sample" or found.share > ALL:
        return
    largest, final = (motion.row.get(name, 0.0) for name in (ORIENTATION, "orientation_error_final_rad"))
    if found.verdict != "healthy":
        yield "The truth starts at the first row, whose noise makes part of these differences."
    elif final < _BACK * largest:
        yield "The truth starts at the first row, and the last one agrees with it: rows in between are off."
    else:
        yield "The truth starts at the first row: its noise, or the errors of a solver, make that difference."


def _wrong_rows(motion: JudgedMotion) -> Iterator[str]:
    """Yield which rows are off, or late, where the others are within a tenth of it."""
    if (repair := motion.repaired) is None:
        yield from _exceptions(motion, motion, {})
        return
    exceptions = [*_exceptions(repair.motion, motion, repair.first_rows)]
    first, *rest = exceptions or [next(_distance(repair.motion))]
    yield f"{repair.wrong}: {first}"
    yield from rest


def _exceptions(motion: JudgedMotion, file: JudgedMotion, first_rows: Mapping[str, int]) -> Iterator[str]:
    """Yield which rows are off; first_rows: measure -> the row of the file at which it begins."""
    t_s = file.problem.times - file.problem.times[0]
    stated: set[int] = set()
    for name, found in exceptions_of(motion).items():
        off = [row + first_rows.get(name, 0) for row in found.off]
        if stated.issuperset(off):  # a wrong row has both wrong
            continue
        stated.update(off)
        quantity = QUANTITY_OF[name]
        of, unit = "" if name == ORIENTATION else f" in {quantity}", UNITS[quantity]
        after = f"{number(float(t_s[off[0]]), _OF_TIME)} s after the first row"
        verb, where = ("is", after) if len(off) == 1 else ("are", f"the first {after}")
        size = f"{'' if len(off) == 1 else 'up to '}{number(found.largest, 2)} {unit}"
        others = f"the others by at most {number(found.rest, 2)} {unit}"
        if found.noise:
            others = f"the noise of the others is {number(found.noise, 2)} {unit}"
        yield f"Only {len(off)} of {found.rows} rows {verb} off{of}, by {size}, {where}; {others}."


def _norms(motion: JudgedMotion) -> Iterator[str]:
    """Yield that attitudes are no rotations, beyond the digits of the file."""
    for name, sentence in _NOT_NORMAL.items():
        if motion.row.get(name, 0.0) > NEGLIGIBLE and not motion.is_at_floor(name):
            yield f"{sentence} by up to {_share(motion.row[name])}."


def _share(value: float) -> str:
    """Return a relative number, as a percentage where it is large."""
    return f"{number(100.0 * value, _DIGITS)} %" if value >= _PER_CENT else number(value, _DIGITS)


def _resolved(error: float, floor: float) -> str:
    """Return the larger of an error and of what the file resolves."""
    return number(max(error, floor), 2)


def _conservation(motion: JudgedMotion) -> Iterator[str]:
    """Yield whether angular momentum and energy are conserved, or how far they are from the truth."""
    if _is_of_omega(motion):  # which has the energy and the momentum of another motion
        return
    row, free, change = motion.row, is_free(motion.problem.of_body.scene), motion.momentum
    noise = {one: motion.noisy.get(f"{one}_drift", 0.0) for one in ("angular_momentum", "rotational_energy")}
    if change is not None and max(change.size, change.direction_rad) > noise["angular_momentum"]:
        yield _momentum_sentence(change, motion.floors.get("angular_momentum_drift", 0.0), free=free)
    name = next((name for name in _ENERGIES if f"{name}{SIGNED}" in row), None)
    if free and motion.energy is not None:
        signed, floor = motion.energy, motion.floors.get("rotational_energy_drift", 0.0)
        if abs(signed) > max(FLOOR_BOUNDS * floor, NEGLIGIBLE, noise["rotational_energy"]):
            yield f"The body {gain_word(signed)} up to {_share(abs(signed))} of its rotational energy."
        elif motion.momentum is None:
            yield f"Rotational energy is conserved to a relative {number(max(abs(signed), floor), 2)}."
    elif name is not None and not motion.is_at_floor(name):
        signed = row[f"{name}{SIGNED}"]
        what = "its rotational energy" if name == _ENERGIES[0] else "its largest kinetic energy"
        yield f"The body {gain_word(signed)} up to {_share(abs(signed))} of {what} relative to the truth."


def _momentum_sentence(change: MomentumChange, floor: float, *, free: bool) -> str:
    largest = max(change.size, change.direction_rad)
    direction = number(change.direction_rad, _DIGITS)
    if largest <= FLOOR_BOUNDS * floor and floor > VAGUE:
        kept = "is conserved" if free else "is the true one"
        left = _share(FLOOR_BOUNDS * floor)
        return f"The file does not show whether angular momentum {kept}: its rows leave {left} open."
    if largest <= FLOOR_BOUNDS * floor:
        what = "conserved" if free else "the true one"
        return f"Angular momentum is {what}, to {_resolved(largest, floor)} of |L|{_AS_RESOLVED}."
    if not free:
        sizes = f"{_share(change.size)} in size and {direction} rad in direction"
        return f"Angular momentum is off the truth by up to {sizes}."
    if largest < NEGLIGIBLE:
        sizes = f"{number(change.size, 2)} of |L| and {number(change.direction_rad, 2)} rad"
        return f"Angular momentum is conserved to {sizes}."
    if change.size < NEGLIGIBLE:
        turned = f"its direction turns by up to {direction} rad, its size is kept"
        return f"Angular momentum is not conserved: {turned}."
    sizes = f"its size changes by up to {_share(change.size)}, its direction by {direction} rad"
    return f"Angular momentum is not conserved: {sizes}."


def _distance(motion: JudgedMotion) -> Iterator[str]:
    """Yield how far attitude or omega, and the path, are from the truth, the larger error first."""
    row, turned = motion.row, [*_turned(motion)]
    measured = motion.path_errors or (() if turned else [one for one in TRAVELLING if one in row])
    name = next(iter(measured), None)
    path = [] if name is None else [_path_error(motion, name)]
    is_path_larger = name is not None and row[name] > max(row.get(one, 0.0) for one in TURNING)
    if name is not None and not motion.is_noise(name):
        is_path_larger |= all(motion.is_noise(one) for one in TURNING if one in row)
    yield from [*path, *turned] if is_path_larger else [*turned, *path]


def _path_error(motion: JudgedMotion, name: str) -> str:
    size = f"{number(motion.row[f'{name}_abs'], _DIGITS)} {UNITS[QUANTITY_OF[name]]}"
    return f"The {name.removesuffix('_error')} is {size} from the truth{_MADE * motion.is_noise(name)}."


def _turned(motion: JudgedMotion) -> Iterator[str]:
    """Yield how far attitude, or else omega, is from the truth."""
    row, until = motion.row, number(motion.row["compared_until_s"], 4)
    if ORIENTATION in row:
        largest, final = row[ORIENTATION], row["orientation_error_final_rad"]
        if _is_of_omega(motion):
            yield f"Omega is up to {_share(row['omega_error'])} of |omega| from the truth."
        if motion.is_at_floor(ORIENTATION):
            error = _resolved(largest, motion.floors[ORIENTATION])
            if motion.floors[ORIENTATION] > VAGUE:
                open_rad = number(min(motion.floor(ORIENTATION), math.pi), 2)
                yield (
                    "The file does not show whether the attitude is the true one: its rows leave the truth "
                    f"open to {open_rad} rad after {until} s."
                )
                return
            yield f"The attitude is the true one for {until} s, to {error} rad{_AS_RESOLVED}."
            return
        before = "" if final > 0.9 * largest else f", {number(largest, _DIGITS)} rad at most before"
        before += _MADE * motion.is_noise(ORIENTATION)
        yield f"The attitude is {_angle(final)} from the truth after {until} s{before}."
    elif "omega_error" in row:
        if motion.is_at_floor("omega_error"):
            error = _resolved(row["omega_error"], motion.floors["omega_error"])
            yield f"Omega is the true one for {until} s, to {error} of |omega|{_AS_RESOLVED}."
        else:
            yield f"Omega is {_share(row['omega_error'])} of |omega| from the truth within {until} s."


def _is_of_omega(motion: JudgedMotion) -> bool:
    """Whether omega is wrong, and too far off for the error of the attitude to be its cause."""
    row = without_exceptions(motion).row  # of a single row, either may be wrong
    error = row.get("omega_error", 0.0)
    limit = max(NEGLIGIBLE, _FARTHER * row.get(ORIENTATION, math.inf), motion.floor("omega_error"))
    return motion.is_omega_misread or bool(error > limit)


def _angle(rad: float) -> str:
    return f"{number(rad, _DIGITS)} rad ({number(math.degrees(rad), _DIGITS)} degrees)"


def _cause(motion: JudgedMotion, case: ExplainedCase) -> Iterator[str]:
    found, takes_step = case.diagnosis, case.case.dt_s is None and motion.is_even
    is_right = ORIENTATION in motion.row and motion.is_at_floor(ORIENTATION) and not _is_of_omega(motion)
    is_right = is_right and not motion.path_errors
    if found is None or (motion.without_omega and found.verdict == "healthy" and not is_right):
        if motion.without_omega and not is_right:
            yield (
                "No wrong reading of the attitudes explains it; with omega in the file more is tried, "
                "such as a wrong inertia."
            )
        elif not is_right and case.reason:
            yield f"No cause was looked for: {case.reason}."
        return
    if found.start is not None:
        yield f"The start differs: {found.start.sentence}."
    if found.verdict == "explained":
        yield f"Likely cause: {found.sentence}."
    elif found.verdict == "nearest":
        yield f"{found.sentence[:1].upper()}{found.sentence[1:]}."
    elif found.per_sample is not None:
        off = number(found.per_sample, 2)
        hint = "; --dt, the step of the program, tells them apart" * takes_step
        if _is_of_omega(motion):  # which no solver makes: the attitude is far better than its omega
            yield "Omega is not the rate of this attitude, and no known fault of a reading explains it."
        elif not is_right:
            yield (
                f"Each row is within a relative {off} of the exact motion from the row before, as of a "
                f"solver with that tolerance, or of a fault as small{hint}."
            )
    elif found.verdict in ("healthy", "strapdown", "lower-order"):
        if not (is_right and found.start is None and found.base == EXACT.name):
            is_cause = found.verdict == "healthy" and found.base != EXACT.name and found.start is None
            method = found.sentence.replace("no fault", "the error of a method without a fault", 1)
            sentence = f"likely cause: {method}" if is_cause else found.sentence
            yield f"{sentence[:1].upper()}{sentence[1:]}."
    elif motion.path_errors or (
        max(motion.row.get(ORIENTATION, 1.0), motion.row.get("omega_error", 0.0)) > NEGLIGIBLE
        and not is_right
    ):
        hint = "; with --dt, the step of the program, more causes are tried" * takes_step
        yield f"No known fault, and no pair of the nearest, explains it{hint}."


def judgement_document(
    ranking: Ranking, cases: Sequence[ExplainedCase] = (), *, evidence: bool = False, opening: str = ""
) -> Document:
    """Return the conclusion and the measures of a single file, or the ranking of several.

    cases: the diagnoses, in the order of the ranking. evidence: whether what they rest on is shown.
    opening: the sentence that is printed already.
    """
    if len(ranking.rows) == 1:
        found = conclusions(ranking.motions[0], next(iter(cases), None))
        parts: list[Part] = [*(one for one in found if one.text != opening), _measure_table(ranking)]
    else:
        parts = [*_ranking_parts(ranking, is_explained=bool(cases))]
        if cases:
            parts += [
                Sentence(f"{motion.name}: {conclusion(motion, case)}")
                for motion, case in zip(ranking.motions, cases, strict=True)
            ]
    if evidence:
        parts += explanation_parts(cases, concluded=True)
    first, *others = (motion.name for motion in ranking.motions)
    more = f" and {count(len(others), 'more file')}" if others else ""
    return Document(f"Judgement of {first}{more}", tuple(parts))


def _measure_table(ranking: Ranking) -> Table:
    """Return the columns of a single file, numbers with three digits; a page also has the formulas."""
    rows = tuple(
        (name, number(value, _DIGITS) if isinstance(value, float) else str(value), _meaning(name))
        for name, value in ranking.data.items()
        if value not in ("", None)
    )
    columns = (Column("measure", "fixed"), Column("value"), Column("meaning", only=("page",)))
    return Table(columns, rows, title="Measures")


def _meaning(name: str) -> str:
    pure = name.removesuffix("_abs").removesuffix(SIGNED).removesuffix(FROM_START)
    if pure not in MEASURES:
        return ""
    if name.endswith("_abs"):
        return MEASURES[pure].absolute_formula
    of_it = {SIGNED: ", with its sign", FROM_START: ", from the first row"}
    return MEASURES[pure].formula + next((text for end, text in of_it.items() if name.endswith(end)), "")


def _ranking_parts(ranking: Ranking, *, is_explained: bool) -> Iterator[Part]:
    energies = _ENERGIES[::-1]
    energy = next((name for name in energies if any(name in row for row in ranking.rows)), energies[0])
    measures = dict.fromkeys(filter(None, (ranking.quantity, "omega_error", energy, f"{energy}{FROM_START}")))
    steps = ["dt_s"] if "dt_s" in ranking.rows[0] else []
    columns = (
        Column("#", "number"),
        Column("file", "name"),
        *(Column(heading(name), "number") for name in (*steps, *measures)),
        Column("outcome"),
    )
    rows = tuple(
        (
            "" if rank is None else str(rank),
            row["file"],
            *(step(row[name]) for name in steps),
            *(scientific(row[name]) if name in row else "" for name in measures),
            row["outcome"] + f": {row['message']}" * bool(row["message"]),
        )
        for rank, row in zip(ranking.ranks, ranking.rows, strict=True)
    )
    yield Sentence(_ranking_sentence(ranking), strong=True)
    # neither the ranking nor an order shows a wrong omega, or wrong rows, with which each explanation begins
    for motion in () if is_explained else ranking.motions:
        texts = [*_wrong_rows(motion)] or ([next(_turned(motion))] if _is_of_omega(motion) else [])
        yield from (Sentence(f"{motion.name}: {text}") for text in texts)
    yield Sentence(_order_sentence(ranking))
    yield Table(columns, rows, title="Files by their distance from the truth")
    yield Table(
        (Column("measure", "fixed"), Column("verdict"), Column("order", "number"), Column("95 %", "fixed")),
        tuple(
            (name, found.verdict, number(found.order, 3), _interval(found))
            for name, found in ranking.orders.items()
        ),
        title="Order over the steps",
    )


def _ranking_sentence(ranking: Ranking) -> str:
    if not ranking.quantity:
        return f"{ranking.rows[0]['scenario']}: {len(ranking.rows)} files, not ranked: no measure in common."
    ended = [motion for motion in ranking.motions if motion.row["outcome"] == "ok"]
    best = [motion.name for motion, rank in zip(ranking.motions, ranking.ranks, strict=True) if rank == 1]
    measure = ranking.quantity.replace("_", " ").removesuffix(" rad")
    unit = " rad" if ranking.quantity == ORIENTATION else ""
    least, most = (f"{scientific(motion.row[ranking.quantity])}{unit}" for motion in (ended[0], ended[-1]))
    if len(best) == len(ended) > 1:
        return f"{names(best)} are equally near to the truth: {measure} at most {most}."
    first = f"{names(best)} {'is' if len(best) == 1 else 'are'} nearest to the truth: {measure} {least}"
    return f"{first}; {ended[-1].name} is farthest: {most}."


def _order_sentence(ranking: Ranking) -> str:
    """Return the order of the first measure that has one, or why there is none."""
    if "dt_s" not in ranking.rows[0]:
        return "No order: --dt states the step of each file, and at least four steps are needed."
    if len(ranking.rows) < _FEWEST_STEPS:
        return f"No order: {len(ranking.rows)} steps are given, and at least {_FEWEST_STEPS} are needed."
    found = next(((name, one) for name, one in ranking.orders.items() if one.order is not None), None)
    if found is None:
        verdicts = dict.fromkeys(one.verdict for one in ranking.orders.values())
        return f"No order: the errors show none over these steps ({names([*verdicts])})."
    name, one = found
    return f"Order {number(one.order, 3)} of {name.replace('_', ' ')} ({_interval(one)}), {one.verdict}."


def _interval(found: Convergence) -> str:
    if found.order is None:
        return ""
    return f"{number(found.order_low, 3)} to {number(found.order_high, 3)}"
