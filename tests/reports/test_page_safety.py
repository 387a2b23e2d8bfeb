"""Safety of the page: names stay text, nothing is fetched, colours have contrast, a large run stays small."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from bodycheck.reports.measurement.case import MeasuredMotion
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.scenarios.serialization import deserialized, serialized
from tests.helpers.copied_scenarios import with_scenarios
from tests.helpers.gate_tables import with_tables
from tests.helpers.html_page import Page, report_page
from tests.helpers.markup_run import HOSTILE

pytestmark = pytest.mark.slow


def test_names_are_text_wherever_they_stand(html: str, page: Page) -> None:
    """No markup in a name, message or summary becomes an element, in the page or inside its data."""
    scripts = [attributes for tag, attributes in page.tags if tag == "script"]
    assert len(scripts) == html.count("<script") == html.count("</script>")
    assert not {"i", "u", "tt", "em"} & {tag for tag, _ in page.tags}
    for text in (HOSTILE, "<b>failed</b>", "<i>invalid</i>", "<u>none</u>", "no <em>such</em> thing"):
        assert text in page.text
        assert text not in html
    assert "{{ 7 * 7 }}" in page.text
    assert page.data
    for data in page.data:
        assert not re.search("[<>&\u2028\u2029]", data)
        json.loads(data)
    scenes = [data for data in map(json.loads, page.data) if "faults" in data]
    assert any(HOSTILE in point["message"] for data in scenes for point in data["faults"])


def test_nothing_is_fetched(html: str, page: Page) -> None:
    """No element or style refers to anything outside the page, and the page's policy forbids fetching."""
    for tag, attributes in page.tags:
        assert tag not in ("link", "img", "iframe", "base", "object")
        assert "src" not in attributes
        assert attributes.get("href", "#").startswith("#")
    (policy,) = [a["content"] for _, a in page.tags if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy
    css = html.partition("<style>")[2].partition("</style>")[0]
    assert "url(" not in css
    assert "@import" not in css


def luminance(colour: str) -> float:
    """Return the relative luminance of #rgb or #rrggbb, as WCAG 2 defines it."""
    digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    parts = [int(digits[i : i + 2], 16) / 255.0 for i in (0, 2, 4)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_have_contrast(html: str, scheme: str) -> None:
    """Text has a contrast of at least 4.5 to 1 with its background, lines and marks of 3 to 1."""
    blocks = re.findall(r":root[^{]*\{(.*?)\}", html.partition("</style>")[0], re.DOTALL)
    colours = dict(re.findall(r"--([\w-]+): (#\w+)", blocks[scheme == "dark"]))

    def contrast(front: str, back: str) -> float:
        low, high = sorted(luminance(colours[name]) + 0.05 for name in (front, back))
        return high / low

    for text in ("ink", "faint", "link"):
        assert contrast(text, "paper") >= 4.5
    for tint in ("good", "floor", "open", "bad", "none"):
        assert contrast("on-tint", tint) >= 4.5
    assert contrast("on-fault", "fault") >= 4.5
    for i in range(8):
        assert contrast(f"engine-{i}", "paper") >= 3.0


@pytest.mark.nightly
def test_a_large_run_stays_light(run: Run) -> None:
    """Twelve scenarios, seventeen methods and six steps take at most 6 MB and 5 s of processor time."""
    scenario, spec = run.problems[0].scenario, run.problems[0].scenario_spec
    sound = [case for case in run.cases if case.ok and case.columns["scenario"] == scenario.name]
    copies = 12 * 17 * 6 // len(sound) + 1
    samples = 101  # as many as most scenarios have
    longer = {**serialized(scenario), "duration_s": 10.0, "samples": samples}
    free = Problem.of(deserialized(longer, spec), spec)
    truth = replace(free.truth, bound_rad=np.zeros(samples))
    problems, cases, methods = [], [], []
    for copy in range(copies):
        name = f"copy-{copy}"
        named = free.scenario.model_copy(update={"name": name})
        problems.append(replace(free, scenario=named, truth=truth))
        cases += [replace(case, columns={**case.columns, "scenario": name}) for case in sound]
        methods.append(run.methods[run.methods["scenario"] == scenario.name].assign(scenario=name))
    noise = np.random.default_rng(0).lognormal(size=samples)
    drawn = [MeasuredMotion(truth.trajectory, dict.fromkeys(case.series, noise)) for case in cases]
    cases = [replace(case, motion=motion) for case, motion in zip(cases, drawn, strict=True)]
    begin = time.process_time()
    html = report_page(
        replace(
            with_tables(run, methods=pd.concat(methods), stability=[]),
            manifest=with_scenarios(run, problems),
            problems=tuple(problems),
            cases=tuple(cases),
        )
    )
    assert time.process_time() - begin < 5.0
    assert len(html.encode()) < 6e6
