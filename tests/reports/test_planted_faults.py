"""Each kind of fault that is planted in a healthy method is reported by a run with default options."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest
from markupsafe import escape

import bodycheck
from bodycheck.adapters.contract import Engine
from bodycheck.adapters.execution import record
from bodycheck.adapters.registry import registered
from bodycheck.examine.probes.probe import probe_rows
from bodycheck.reports.document import escaped_markdown, markdown
from bodycheck.reports.summary.sentences import Summary, run_document
from tests.helpers.html_page import report_page
from tests.helpers.planted_faults import BASES, FAULTS, NO_FAULT, Fault, Faulty
from tests.helpers.reported_results import reported_results

NOT_BY_PROBES = {
    "position-by-old-velocity": "an error of order 1 in the position, and no wrong reading",
    "speed-clamped": "a probe is no faster than 4 m/s",
}
"""Faults that only the verdicts and orders of a whole run detect."""

EVERY = 40
"""A push runs one fault in this many through smoke, and all of them through the probes."""


def test_the_table_of_faults_is_long_and_clear() -> None:
    """At least 27 kinds have unique names, and each undetectable one has its reason."""
    assert len({fault.name for fault in FAULTS}) == len(FAULTS) >= 27
    for fault in FAULTS:
        assert fault.planted
        assert set(fault.undetectable) <= set(BASES)
        assert all(fault.undetectable.values())


@pytest.mark.nightly
@pytest.mark.parametrize(
    "base", [pytest.param(base, marks=() if base == "rk4" else pytest.mark.nightly) for base in BASES]
)
def test_probes_see_each_planted_fault_but_those_that_they_cannot(base: str) -> None:
    """Each fault gives a finding or a property; the sound base and the excepted faults do not."""
    adapter = Faulty(base)
    engine = Engine(adapter.name, adapter.version, adapter.methods)
    silent = set()
    for name, method in adapter.methods.items():
        rows = probe_rows(engine, method, lambda _, case: record(adapter, case))
        if not any(row["verdict"] == "inconsistent" or row["message"] for row in rows):
            silent.add(name)
    undetectable = {fault.name for fault in FAULTS if base in fault.undetectable}
    assert silent == {NO_FAULT, *undetectable, *NOT_BY_PROBES}


def check_reports(base: str, faults: Sequence[Fault]) -> None:
    """Run smoke with default options: each fault must be reported, with quantity and size, on every page.

    A fault that the table calls undetectable, and the sound base, must not be reported.
    """
    adapter = Faulty(base)
    methods = [f"{adapter.name}:{name}" for name in (NO_FAULT, *(fault.name for fault in faults))]
    with registered(adapter):
        run = bodycheck.run(["smoke"], engines=methods, speed=False)
    found = reported_results(run)
    reported = {f"{adapter.name}:{fault.name}" for fault in faults if base not in fault.undetectable}
    assert set(found) == reported
    html = re.sub('<span class="whole">(.*?)</span>', r"\1", report_page(run))  # words that are kept whole
    pages = {"markdown": markdown(run_document(run)), "html": html}
    sentences = " ".join(Summary.of(run).sentences)
    for method, results in found.items():
        assert any(one.quantity and one.size > 0.0 and one.quantity in one.text for one in results), method
        assert method in sentences
        for page, text in pages.items():
            sentence = results[0].sentence
            shown = str(escape(sentence)) if page == "html" else escaped_markdown(sentence)
            assert shown in text, (page, method)
            assert results[0].reproduce in text, (page, method)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("base", "first"),
    [
        pytest.param(base, place, marks=pytest.mark.nightly if place else ())
        for place, base in enumerate(BASES)
    ],
)
def test_smoke_reports_a_sample_of_the_planted_faults(base: str, first: int) -> None:
    """The limit, the order, the probes or a property reports each fault; the sound base has no finding."""
    check_reports(base, FAULTS[first * EVERY // 2 :: EVERY])


@pytest.mark.nightly
@pytest.mark.parametrize("base", BASES)
def test_smoke_reports_each_planted_fault(base: str) -> None:
    """All planted faults are reported as those of the sample are."""
    check_reports(base, FAULTS)
