"""The report: complete, equal to the tables, safe against names, and drawn without a network."""

from __future__ import annotations

import json
import re
import shutil
import time
from base64 import b64decode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from playwright.sync_api import Error, expect, sync_playwright
from playwright.sync_api import Page as Browser

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import _registered, register_adapter
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.case import CaseResult
from bodycheck.reports.figures import (
    DASHES,
    LINE_POINTS,
    MARKERS,
    packed_line,
    styles,
    thinned_maxima,
    thinned_times,
)
from bodycheck.reports.html import render_report
from bodycheck.reports.run import Run
from bodycheck.reports.summary import STATES, Cell, common_step, summary_cells, verdict_sentences
from bodycheck.reports.wording import names, number, scientific, step
from bodycheck.runner import run as measure

Browsed = tuple[Browser, list[Error]]

HOSTILE = "<script>alert(1)</script>"
FREE = f"""
name = "{HOSTILE}"
summary = "</script><!-- %{{x}} $x$ \\u2028 <b>bold</b> & {{{{ 7 * 7 }}}}"
duration_s = 1.0
samples = 11
steps_s = [0.05, 0.02, 0.01, 0.005]
[body]
mass_kg = 1.0
inertia_kg_m2 = [1.0, 2.0, 2.5]
[initial]
omega_body_rad_s = [0.3, 1.0, -0.2]
"""
FORCED = (
    FREE.replace(HOSTILE, "forced")
    + """
[[forcing]]
kind = "torque"
axes = "world"
value_n_m = [0.1, 0.2, -0.1]
"""
)


class Tampered:
    """A simulation of the reference that breaks in the way its method is named after."""

    stepping = "python"

    def __init__(self, inner: Simulation, how: str) -> None:
        self._inner, self._how, self._steps = inner, how, 0
        self.reset, self.apply, self.close = inner.reset, inner.apply, inner.close

    def read_back(self) -> ReadBack:
        """Tell another mass, if that is the fault."""
        held = self._inner.read_back()
        return replace(held, mass=3.0) if self._how == "<i>invalid</i>" else held

    def advance(self, steps: int) -> None:
        """Raise, if that is the fault."""
        if self._how == "<b>failed</b>":
            raise RuntimeError(f"{HOSTILE} <!-- & 'quoted'")
        self._steps += steps
        self._inner.advance(steps)

    def read(self) -> Reading:
        """Lose the position half-way, if that is the fault."""
        reading = self._inner.read()
        if self._how == "unstable" and self._steps > 5:
            return replace(reading, position=np.full(3, np.nan))
        return reading


class Odd:
    """An engine with a hostile name, each of whose methods fails in its own way."""

    name = HOSTILE
    version = "1 < 2"

    def __init__(self) -> None:
        known = Reference().methods["rk4"]
        self.methods: Mapping[str, Method] = {
            name: replace(known, name=name, formula="a < b & c", changed_defaults=("<u>none</u>",))
            for name in ("<b>failed</b>", "<i>invalid</i>", "unstable", "unsupported", "sound")
        }

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse by name."""
        del scene
        return "no <em>such</em> thing" if method == "unsupported" else None

    def build(self, scene: Scene, method: str, dt_s: float) -> Any:
        """Return the reference's rk4, tampered with."""
        return Tampered(Reference().build(scene, "rk4", dt_s), method)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run of the reference and the odd engine on a free and a forced scenario."""
    files = [tmp_path_factory.mktemp("scenarios") / name for name in ("free.toml", "forced.toml")]
    for file, text in zip(files, (FREE, FORCED), strict=True):
        file.write_text(text, encoding="utf-8")
    register_adapter(Odd())
    measured = measure(files, engines=["reference", Odd.name])
    del _registered[Odd.name]
    absent = {"absent": {"unavailable": "absent cannot be imported: <tt>no module</tt>"}}
    return replace(measured, manifest={**measured.manifest, "engines": absent | measured.manifest["engines"]})


@pytest.fixture(scope="module")
def html(run: Run) -> str:
    """Return the report of that run."""
    return render_report(run)


@dataclass
class Table:
    """A table of the page: its class and its rows of cells, each its text."""

    kind: str
    rows: list[list[str]] = field(default_factory=list)

    def records(self) -> list[dict[str, str]]:
        """Return the rows under the names of the first."""
        return [dict(zip(self.rows[0], row, strict=True)) for row in self.rows[1:]]


class Page(HTMLParser):
    """What a browser would find in the page; unbalanced tags fail."""

    VOID = frozenset({"meta", "input", "wbr", "br", "link", "img"})

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.tables: list[Table] = []
        self.text = ""
        self.data: list[str] = []
        self._open: list[str] = []
        self.feed(html)
        self.close()
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the tag."""
        attributes = {name: value or "" for name, value in attrs}
        self.tags.append((tag, attributes))
        if tag == "table":
            self.tables.append(Table(attributes.get("class", "")))
        elif tag == "tr":
            self.tables[-1].rows.append([])
        elif tag in ("td", "th"):
            self.tables[-1].rows[-1].append("")
        elif tag == "script" and attributes.get("type") == "application/json":
            self.data.append("")
        if tag not in self.VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag that closes itself, as those of SVG do."""
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        """Hold each end against its start."""
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Give the text to the cell, the data or the page that it stands in."""
        if self._open and self._open[-1] == "script":
            if self.data and self.tags[-1][1].get("type"):
                self.data[-1] += data
        elif not self._open or self._open[-1] != "style":
            self.text += data
            if {"td", "th"} & set(self._open):
                self.tables[-1].rows[-1][-1] += data

    def with_class(self, name: str) -> list[Table]:
        """Return the tables of that class."""
        return [table for table in self.tables if table.kind == name]


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    """Return the report as parsed."""
    return Page(html)


def test_the_page_holds_together(page: Page) -> None:
    """Tags balance, ids are unique, links inside the page lead somewhere, tables have captions and scopes."""
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in page.tags:
        for key in ("aria-labelledby", "href"):
            if key in attributes:
                assert attributes[key].removeprefix("#") in ids
    kinds = [tag for tag, _ in page.tags]
    assert kinds.count("caption") == kinds.count("table") == len(page.tables)
    assert all("scope" in attributes for tag, attributes in page.tags if tag == "th")


def same(shown: str, stored: Any, digits: int = 4) -> bool:
    """Whether a shown number is the stored one at so many digits; empty is missing."""
    if shown == "":
        return bool(pd.isna(stored))
    return float(shown) == float(f"{stored:.{digits}g}")


def test_every_number_of_the_case_tables_is_that_of_the_results(page: Page, run: Run) -> None:
    """Row by row the tables repeat results.csv: who, outcome, message, command, and each number shown."""
    shown = [record for table in page.with_class("cases") for record in table.records()]
    stored = run.results.to_dict("records")
    assert len(shown) == len(stored)
    for record, row in zip(shown, stored, strict=True):
        assert record.pop("engine:method") == f"{row['engine']}:{row['method']}"
        assert record.pop("outcome") == row["outcome"]
        assert record.pop("message") == row["message"]
        assert record.pop("reproduce") == f"copy {row['reproduce']}"
        told = record.pop("dt_s or tolerance")
        fineness = row["tolerance"] if pd.isna(row["dt_s"]) else row["dt_s"]
        assert pd.isna(fineness) if told == "" else float(told) == fineness
        assert {"orientation_error_rad", "energy_drift", "cpu_s"} <= record.keys()
        for column, text in record.items():
            assert same(text, row[column]), f"{column}: {text} is not {row[column]!r}"


def rows_of(table: pd.DataFrame, scenario: str, engine: str, method: str) -> pd.DataFrame:
    """Return the rows of one method on one scenario."""
    who = (table["scenario"] == scenario) & (table["engine"] == engine) & (table["method"] == method)
    return table[who]


def test_the_summary_is_that_of_the_tables(page: Page, run: Run) -> None:
    """Each cell shows the verdict, the order and the error at the common step that the tables have."""
    (summary,) = page.with_class("summary")
    heads = [head.removesuffix(" s").rsplit("dt ", 1) for head in summary.rows[0][1:]]
    verdicts = run.methods[run.methods["quantity"] == "orientation_error_rad"]
    for who, *cells in summary.rows[1:]:
        engine, method = who.rsplit(":", 1)
        for cell, (scenario, dt_s) in zip(cells, heads, strict=True):
            own = rows_of(run.results, scenario, engine, method)
            found = rows_of(verdicts, scenario, engine, method)
            if own["outcome"].eq("ok").any() and len(found):
                assert STATES[found["verdict"].item()].word in cell
                assert np.isnan(found["order"].item()) or f"order {found['order'].item():.2f}" in cell
            compared = own[own["dt_s"].isna() | (own["dt_s"] == float(dt_s))]
            finest = compared.sort_values("tolerance").head(1)  # of a method that is told a tolerance
            for error in finest["orientation_error_rad"].dropna():
                assert f"{scientific(error)} rad" in cell


def test_what_went_wrong_is_never_hidden(page: Page, run: Run) -> None:
    """Outcomes are counted; failed, invalid, unstable, unsupported and absent stand there with reasons."""
    for outcome, amount in run.manifest["outcomes"].items():
        assert f"{amount} {outcome}" in page.text
    (summary,) = page.with_class("summary")
    for row in summary.rows[1:]:
        for word in ("failed", "invalid", "unstable", "unsupported"):
            if word in row[0]:
                assert all(STATES[word].word in cell for cell in row[1:])
    (faults,) = page.with_class("faults")
    stored = run.results[~run.results["outcome"].isin(["ok", "unsupported"])]
    assert {row[-1] for row in faults.rows[1:]} == set(stored["message"])
    assert sum(len(row[2].split(", ")) for row in faults.rows[1:]) == len(stored)
    assert set(stored["outcome"]) == {"failed", "invalid", "unstable"}
    assert "absent cannot be imported: <tt>no module</tt>" in page.text
    told = " ".join(verdict_sentences(run, summary_cells(run)))
    assert all(word in told for word in ("failed", "invalid", "unstable"))


def test_the_verdict_names_what_is_not_as_it_should_be(run: Run) -> None:
    """A plateau, a lower order and an order that cannot be told are each said of the method they befell."""
    cells = summary_cells(run)
    forced = cells["forced"]
    odd = {
        ("reference", "rk4"): replace(forced["reference", "rk4"], order=2.0),
        ("reference", "m1"): Cell("does-not-converge"),
        ("reference", "m2"): Cell("pre-asymptotic"),
    }
    told = verdict_sentences(run, {**cells, "forced": {**forced, **odd}})
    assert "Of a lower order than in theory: reference:rk4 in forced (2, in theory 4)." in told
    assert "The orientation error does not converge: reference:m1 in forced." in told
    pairs = sum(len(methods) for methods in cells.values())
    assert f"No order can be told for 1 of {pairs} pairs of method and scenario, in forced." in told
    assert " methods but reference:rk4, reference:m1, reference:m2, " in told[0]
    one = {"forced": {("reference", "rk3"): Cell("unsupported"), ("reference", "rk4"): Cell("at-floor")}}
    first, *_ = verdict_sentences(run, one)
    assert first == "reference:rk4 converges with its order of theory, or is at the floor, in forced."


def test_every_verdict_and_outcome_has_its_word() -> None:
    """Whatever a method or a case can come to has a symbol, a word and a meaning."""
    verdicts = "converges pre-asymptotic does-not-converge at-floor chaotic unstable too-few-points"
    outcomes = "unstable failed timeout unsupported invalid"
    assert {*verdicts.split(), *outcomes.split()} <= STATES.keys()


def test_names_are_text_wherever_they_stand(html: str, page: Page) -> None:
    """No markup of a name, message or summary becomes an element, in the page or inside its data."""
    scripts = [attributes for tag, attributes in page.tags if tag == "script"]
    assert len(scripts) == html.count("<script") == html.count("</script>")
    assert not {"i", "u", "tt", "em"} & {tag for tag, _ in page.tags}
    for text in (HOSTILE, "<b>failed</b>", "<i>invalid</i>", "<u>none</u>", "no <em>such</em> thing"):
        assert text in page.text
    assert "{{ 7 * 7 }}" in page.text
    assert page.data
    for data in page.data:
        assert not re.search("[<>&\u2028\u2029]", data)
        json.loads(data)
    assert any(HOSTILE in point["message"] for point in json.loads(page.data[0])["faults"])


def test_nothing_is_fetched(html: str, page: Page) -> None:
    """No element or style names anything outside the page, and the page forbids itself to fetch."""
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
    """Texts stand out 4.5 to 1 from what is behind them, lines and marks 3 to 1."""
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


def test_a_run_without_speed_says_so(run: Run) -> None:
    """Where no processor time was measured there is a sentence in place of the plot."""
    cases = tuple(
        CaseResult({k: v for k, v in case.columns.items() if not k.startswith("cpu_")}, series=case.series)
        for case in run.cases
    )
    page = Page(render_report(replace(run, cases=cases)))
    assert page.text.count("No processor time was measured.") == len(run.subjects)
    assert "speed" not in [attributes.get("data-plot") for _, attributes in page.tags]


def test_a_large_run_stays_light(run: Run) -> None:
    """Twelve scenarios by seventeen methods by six steps take at most 8 MB and 5 s."""
    free = run.subjects[0]
    sound = [case for case in run.cases if case.ok and case.columns["scenario"] == free.scenario.name]
    copies = 12 * 17 * 6 // len(sound) + 1
    subjects, cases, methods = [], [], []
    for copy in range(copies):
        name = f"copy-{copy}"
        subjects.append(replace(free, scenario=free.scenario.model_copy(update={"name": name})))
        cases += [replace(case, columns={**case.columns, "scenario": name}) for case in sound]
        methods.append(run.methods[run.methods["scenario"] == free.scenario.name].assign(scenario=name))
    noise = np.random.default_rng(0).lognormal(size=101)  # as many samples as most scenarios have
    cases = [replace(case, series=dict.fromkeys(case.series, noise)) for case in cases]
    begin = time.perf_counter()
    html = render_report(
        replace(run, subjects=tuple(subjects), cases=tuple(cases), methods=pd.concat(methods))
    )
    assert time.perf_counter() - begin < 5.0
    assert len(html.encode()) < 8e6


def test_thinned_lines_keep_their_peaks() -> None:
    """A line of many samples keeps its largest value and its last time; a short one keeps every sample."""
    values = np.random.default_rng(1).random(10_007)
    times = np.arange(10_007.0)
    assert len(thinned_times(times)) == len(thinned_maxima(values)) <= LINE_POINTS
    assert thinned_maxima(values).max() == values.max()
    assert thinned_times(times)[-1] == times[-1]
    assert np.array_equal(thinned_maxima(values[:LINE_POINTS]), values[:LINE_POINTS])
    unpacked = np.frombuffer(b64decode(str(packed_line(values))), dtype="<f4")
    assert np.array_equal(unpacked, thinned_maxima(values).astype("f4"))
    assert packed_line(np.zeros(50)) == 0.0


def test_lines_can_be_told_without_colour() -> None:
    """No two of as many methods as there are pairs of marker and dash look alike."""
    several = styles((f"engine-{i % 4}", f"method-{i}") for i in range(len(MARKERS) * len(DASHES)))
    assert len({(style.marker, style.dash) for style in several.values()}) == len(several)


def test_methods_are_compared_at_the_finest_step_that_most_have() -> None:
    """Steps that only some methods were refined to are not the common one; without steps there is none."""
    steps = [None, 0.02, 0.01, 0.02, 0.01, 0.005, 0.02, 0.01]
    cases = [CaseResult({"dt_s": dt_s, "outcome": "ok"}) for dt_s in steps]
    assert common_step([*cases, CaseResult({"dt_s": 0.02, "outcome": "unsupported"})]) == 0.01
    assert common_step(cases[:1]) is None


@pytest.mark.parametrize("value", [0.0, 1e-300, -2.5e-17, 1.0, 0.1, 12345.678, 1e5, 6.02e23])
def test_numbers_read_back(value: float) -> None:
    """What is shown parses to the value at the shown precision, a step to the very same double."""
    assert float(number(value)) == float(f"{value:.4g}")
    assert float(scientific(value)) == float(f"{value:.3g}")
    assert float(step(value)) == value


def test_lists_read_as_sentences() -> None:
    """Names are joined as in a sentence; of a long list the rest is counted."""
    assert names(["a"]) == "a"
    assert names(["a", "b", "c"]) == "a, b and c"
    assert names([str(i) for i in range(10)]) == "0, 1, 2, 3, 4, 5, 6 and 3 more"


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
LONG_MS = 120_000
"""What the browser may take on a machine that is busy."""
expect.set_options(timeout=LONG_MS)


@pytest.fixture
def opened(html: str, tmp_path: Path) -> Iterator[Browsed]:
    """Return the report, opened in Chromium, and the errors of its scripts so far."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on the path")
    place = tmp_path / "report.html"
    place.write_text(html, encoding="utf-8")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"], timeout=LONG_MS)
        page = browser.new_page(viewport={"width": 1200, "height": 600})
        page.set_default_timeout(LONG_MS)
        errors: list[Error] = []
        page.on("pageerror", lambda error: errors.append(error))
        page.goto(place.as_uri())
        yield page, errors
        browser.close()


def test_the_browser_draws_every_plot(opened: Browsed) -> None:
    """All plots in view have their lines, no script fails, and a name with markup is text in a label."""
    page, errors = opened
    page.set_viewport_size({"width": 1200, "height": 20_000})
    expect(page.locator("[data-plot][data-drawn]")).to_have_count(6)
    assert page.locator("g[class^='trace scatter']").count() > 6 * 10
    page.evaluate(
        """() => {
          const plot = document.querySelector("[data-plot=error]");
          const sound = plot.data.findIndex(trace => trace.name.includes("sound"));
          Plotly.Fx.hover(plot, [{ curveNumber: sound, pointNumber: 0 }]);
        }"""
    )
    expect(page.locator("[data-plot=error] .hoverlayer").first).to_contain_text(f"{HOSTILE}:sound")
    assert errors == []


def test_plots_wait_until_they_are_seen_or_printed(opened: Browsed) -> None:
    """Plots far below the window are not drawn when the page opens, but are before it is printed."""
    page, errors = opened
    page.evaluate("() => new Promise(seen => new IntersectionObserver(seen).observe(document.body))")
    assert page.locator("[data-plot][data-drawn]").count() < 6
    page.emulate_media(media="print")
    page.evaluate("() => dispatchEvent(new Event('beforeprint'))")
    expect(page.locator("[data-plot][data-drawn]")).to_have_count(6)
    assert errors == []
