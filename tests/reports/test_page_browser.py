"""The page in a browser: plots, controls, layout, light and dark colours, printing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import pytest
from playwright.sync_api import Browser, Error, Page, expect

from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.templating import asset
from tests.helpers.markup_run import HOSTILE

pytestmark = pytest.mark.slow

LONG_MS = 120_000
SECTIONS = 2
PLOTS = 3 * SECTIONS + 1


@pytest.fixture
def opened(chromium: Browser, report_file: Path) -> Iterator[Page]:
    """Return the report in its own window, never idle; an error in a script fails the test."""
    page = chromium.new_page(viewport={"width": 1200, "height": 600})
    page.set_default_timeout(LONG_MS)
    errors: list[Error] = []
    page.on("pageerror", lambda error: errors.append(error))
    page.add_init_script(
        "window.requestIdleCallback = call => { window.idle = [...(window.idle ?? []), call]; }"
    )
    page.goto(report_file.as_uri())
    yield page
    assert errors == []
    page.close()


def draw_all(page: Page, width: int = 1200) -> None:
    """Make the window as tall as the page, so that everything is in view, and wait until it is drawn."""
    page.set_viewport_size({"width": width, "height": 25_000})
    expect(page.locator("[data-plot][data-drawn]")).to_have_count(PLOTS)
    expect(page.locator("[data-motion][data-drawn]")).to_have_count(SECTIONS)


def test_the_browser_draws_every_plot(opened: Page) -> None:
    """All plots in view have their lines, and markup in a name is plain text in a label."""
    draw_all(opened)
    assert opened.locator("g[class^='trace scatter']").count() > PLOTS * 5
    opened.evaluate(
        """() => {
          const plot = document.querySelector("[data-plot=error]");
          const sound = plot.data.findIndex(trace => trace.name?.includes("sound"));
          Plotly.Fx.hover(plot, [{ curveNumber: sound, pointNumber: 0 }]);
        }"""
    )
    label = opened.locator("[data-plot=error] .hoverlayer").first
    expect(label).to_contain_text(f"{HOSTILE}:sound")
    expect(label).to_contain_text("order 4")


def test_an_axis_of_a_decade_has_more_numbers_than_one(chromium: Browser) -> None:
    """The axis has 1, 2 and 5 of each decade as numbers; with more decades, or no points, it has powers."""
    page = chromium.new_page()
    looks = f"const colour = () => '#000'; {asset('templates/plot_style.js')}"
    texts = f"all => {{ {looks} return all.map(values => logAxis('', values).ticktext ?? []); }}"
    steps, finer, two, many, none = page.evaluate(
        texts, [[1e-3, 1e-2], [2e-5, 5e-5], [5e-4, 2e-2], [1e-5, 1e-2], []]
    )
    page.close()
    assert {"0.001", "0.002", "0.005", "0.01"} <= set(steps)
    assert {"2e-5", "5e-5"} <= set(finer)
    assert {"0.001", "0.002", "0.005", "0.01", "0.02"} <= set(two)
    assert many == none == []


@pytest.mark.nightly
def test_failed_cases_are_at_the_edge_of_the_speed_plot(opened: Page) -> None:
    """Failed, invalid and unstable cases have marks at the edge, unsupported ones none; texts stay plain."""
    draw_all(opened)
    texts = opened.evaluate(
        """() => document.querySelector("[data-plot=speed]").data
          .filter(trace => trace.xaxis === "x2").map(trace => trace.text)"""
    )
    reported = " ".join(texts)
    assert all(word in reported for word in ("failed", "invalid", "unstable"))
    assert "unsupported" not in reported
    opened.evaluate(
        """() => {
          const plot = document.querySelector("[data-plot=speed]");
          const failed = plot.data.findIndex(trace => trace.xaxis === "x2" && trace.text.includes("failed"));
          Plotly.Fx.hover(plot, [{ curveNumber: failed, pointNumber: 0 }], ["x2y2"]);
        }"""
    )
    expect(opened.locator("[data-plot=speed] .hoverlayer").first).to_contain_text("<b>failed</b>")
    overall = opened.evaluate(
        "() => document.querySelector('[data-plot=overall]').data.map(trace => trace.text)"
    )
    assert sum("not measured" in str(text) for text in overall) == 3


@pytest.mark.nightly
def test_a_choice_of_error_changes_plots_and_tables(opened: Page) -> None:
    """The plots show the chosen error, and only its table is visible."""
    draw_all(opened)
    section = opened.locator("section.scenario").first
    section.locator("details:has(> div .cheapest) > summary").click()
    for error, title in (
        ("energy_drift", "energy drift"),
        ("orientation_error_rad", "orientation error, rad"),
    ):
        opened.locator("#measure").select_option(error)
        expect(section.locator("[data-plot=speed] .ytitle")).to_contain_text(title)
        expect(section.locator("[data-plot=error] .ytitle")).to_contain_text(title)
        assert section.locator("[data-error]:visible").evaluate_all(
            "all => all.map(one => one.dataset.error)"
        ) == [error]


COLOURS = """() => [...new Set(document.querySelector('section.scenario [data-plot=drift]').data
  .filter(trace => trace.line).map(trace => trace.line.color))]"""
CONTEXT = "() => getComputedStyle(document.documentElement).getPropertyValue('--context').trim()"


NAMES = """() => document.querySelector('section.scenario [data-plot=drift]').data
  .map(trace => trace.name ?? '').join(', ')"""


@pytest.mark.nightly
def test_the_legend_selects_lines(opened: Page) -> None:
    """Selected lines have their engine's colour, others are grey or hidden; the address keeps the choice."""
    draw_all(opened)
    grey = opened.evaluate(CONTEXT)
    assert len(opened.evaluate(COLOURS)) == 2  # the odd engine, and the reference in grey
    assert grey in opened.evaluate(COLOURS)
    opened.get_by_label("others in grey").uncheck()
    assert len(opened.evaluate(COLOURS)) == 1
    opened.get_by_role("button", name="only reference").click()
    (ink,) = opened.evaluate(COLOURS)
    assert ink != grey
    assert opened.get_by_role("checkbox", name="reference", exact=True).is_checked()
    opened.locator("details.lines > summary").click()
    box = opened.locator("#lines li", has_text="reference:rk4").locator("input")
    box.uncheck()
    assert "reference:rk4" not in opened.evaluate(NAMES)
    assert "reference:cf4" in opened.evaluate(NAMES)
    address = opened.url
    opened.goto("about:blank")
    opened.goto(address)
    draw_all(opened)
    assert not box.is_checked()
    assert not opened.get_by_label("others in grey").is_checked()
    assert "reference:rk4" not in opened.evaluate(NAMES)
    assert "reference:cf4" in opened.evaluate(NAMES)


@pytest.mark.nightly
def test_equal_lines_are_one_with_all_names(opened: Page) -> None:
    """The reference's rk4 and the odd engine's copy of it are one line, labelled with both names."""
    draw_all(opened)
    opened.get_by_role("checkbox", name="reference", exact=True).check()
    names = opened.evaluate(
        "() => document.querySelector('[data-plot=error]').data.map(trace => trace.name ?? '')"
    )
    both = [name for name in names if "reference:rk4" in name]
    assert both
    assert all(":sound" in name for name in both)
    labels = opened.evaluate(
        "() => document.querySelector('[data-plot=error]').layout.annotations.map(a => a.text)"
    )
    place = labels.index("reference:rk4")
    assert labels[place + 1].endswith(":sound")
    assert labels[place + 1].startswith("= ")


def cheapest(run: Run, scenario: str, engine: str, tolerance: float) -> list[dict[str, object]]:
    """Return the cheapest rows that meet the tolerance, as do all finer rows of their method."""
    rows = run.results[(run.results["scenario"] == scenario) & (run.results["engine"] == engine)]
    rows = rows.assign(
        error=rows["orientation_error_rad"] + rows["truth_bound_rad"],
        fineness=rows["dt_s"].fillna(rows["tolerance"]).fillna(0.0),
    )
    found = []
    for _, own in rows.groupby("method"):
        finest_first = own.sort_values("fineness")
        met = (finest_first["outcome"].eq("ok") & (finest_first["error"] <= tolerance)).cummin()
        found += finest_first[met & finest_first["cpu_s"].notna()].to_dict("records")
    least = min((row["cpu_s"] for row in found), default=None)
    return [row for row in found if row["cpu_s"] == least]


@pytest.mark.nightly
def test_the_slider_answers_for_each_engine(opened: Page, run: Run) -> None:
    """At each tolerance an engine's row is its cheapest case that meets it; a cell that meets it is green."""
    scenario = run.problems[0].scenario.name
    opened.locator("#scope").select_option(scenario)
    slider = opened.locator("#error")
    slider.focus()
    opened.keyboard.press("Home")
    for decade in range(1, 13):
        tolerance = float(f"1e-{decade}")
        assert float(opened.locator("#tolerance").inner_text().removesuffix(" rad")) == tolerance
        for row in opened.locator(".answers tbody tr").all():
            engine = row.locator("th").inner_text()
            method, setting, error, speed, limiting, commands = row.locator("td").all_inner_texts()
            named = (method, 0.0 if setting == "none" else float(setting))
            (expected,) = (
                row
                for row in cheapest(run, scenario, engine, tolerance)
                if (row["method"], row["fineness"]) == named
            )
            assert limiting == scenario
            assert float(error) == pytest.approx(expected["error"], rel=6e-3)
            assert float(speed) == pytest.approx(
                run.problems[0].scenario.duration_s / expected["cpu_s"], rel=6e-3
            )
            assert str(expected["reproduce"]) in commands
        cells = opened.locator("#heat tbody tr").first.locator("td:has(a[title*=':sound in'])")
        own = run.results[(run.results["scenario"] == scenario) & (run.results["method"] == "sound")]
        met = (own["orientation_error_rad"] + own["truth_bound_rad"] <= tolerance).any()
        expect(cells.first).to_have_class("tint-good" if met else "tint-open")
        opened.keyboard.press("ArrowRight")


@pytest.mark.nightly
def test_the_address_keeps_the_question(opened: Page) -> None:
    """A link restores tolerance, scenario and map; a link to a cell also opens the cell."""
    slider = opened.locator("#error")
    slider.focus()
    opened.keyboard.press("End")
    opened.locator("#map-shows").select_option("error")
    opened.locator("#map-step").select_option("0.02")
    opened.locator("#scope").select_option(index=1)
    opened.locator("#heat tbody td a").first.click()
    expect(opened.locator("details.cell[open] .cases")).to_be_visible()
    rows, cells = (opened.locator(place).inner_text() for place in (".answers", "#heat"))
    address = opened.url
    assert "error=1e-12" in address
    opened.goto("about:blank")
    opened.goto(address)
    expect(opened.locator("#tolerance")).to_have_text("1e-12 rad")
    expect(opened.locator("details.cell[open] .cases")).to_be_visible()
    assert opened.locator(".answers").inner_text() == rows
    assert opened.locator("#heat").inner_text() == cells


def test_the_map_shows_the_error_at_a_step_and_the_speed(opened: Page, run: Run) -> None:
    """The map shows the numbers of the results, and those within the tolerance are green."""
    scenario = run.problems[0].scenario.name
    own = run.results[(run.results["scenario"] == scenario) & (run.results["method"] == "sound")].set_index(
        "dt_s"
    )
    cell = opened.locator("#heat tbody tr").first.locator("td:has(a[title*=':sound in'])").first
    opened.locator("#map-shows").select_option("error")
    for dt_s in ("0.05", "0.005"):
        opened.locator("#map-step").select_option(dt_s)
        error = own["orientation_error_rad"][float(dt_s)]
        assert float(cell.inner_text()) == pytest.approx(error, rel=6e-2)
        expect(cell).to_have_class("tint-good" if error <= 1e-3 else "tint-open")
    opened.locator("#map-shows").select_option("cost")
    met = own[own["orientation_error_rad"] + own["truth_bound_rad"] <= 1e-3]
    speed = (met["duration_s"] / met["cpu_s"]).max()
    assert float(cell.inner_text().removesuffix("×")) == pytest.approx(speed, rel=6e-2)


def test_a_heading_sorts_its_table(opened: Page) -> None:
    """Numbers are sorted by size, in both directions, and empty cells come last."""
    table = opened.locator("table.standing").first
    opened.get_by_role("button", name="own methods").first.click()
    head = table.locator("th", has_text="energy drift").first
    place = head.evaluate("head => head.cellIndex")
    for sort in ("ascending", "descending"):
        head.get_by_role("button").click()
        assert head.get_attribute("aria-sort") == sort
        texts = table.locator("tbody tr").evaluate_all(
            "(rows, place) => rows.map(row => row.cells[place].textContent)", place
        )
        numbers = [float(text) for text in texts if text]
        assert len(numbers) > 5
        assert numbers == sorted(numbers, reverse=sort == "descending")
        assert not any(texts[len(numbers) :])


@pytest.mark.nightly
def test_a_plot_is_saved_as_picture_and_data(opened: Page, run: Run) -> None:
    """The CSV has each line's name and every case, the picture is an SVG, and a plot can be enlarged."""
    draw_all(opened)
    figure = opened.locator("figure:has([data-plot=error])").first
    with opened.expect_download() as saved:
        figure.get_by_role("button", name="CSV").click()
    head, *rows = Path(saved.value.path()).read_text(encoding="utf-8").splitlines()
    assert head == 'line,"step, s (finer to the right)","orientation error, rad"'
    own = run.results[(run.results["scenario"] == HOSTILE) & (run.results["method"] == "sound")]
    points = (row.split(",")[-2:] for row in rows if ":sound" in row)
    written = {float(dt_s): float(error) for dt_s, error in points}
    for dt_s, error in zip(own["dt_s"], own["orientation_error_rad"], strict=True):
        assert written[dt_s] == pytest.approx(error, rel=1e-3)
    with opened.expect_download() as saved:
        figure.get_by_role("button", name="SVG").click()
    assert "<svg" in Path(saved.value.path()).read_text(encoding="utf-8")
    plot = figure.locator("[data-plot]")
    before = plot.bounding_box()
    figure.get_by_role("button", name="enlarge").click()
    after = plot.bounding_box()
    assert before
    assert after
    assert after["width"] > before["width"] + 100


def test_a_link_opens_its_plot(opened: Page) -> None:
    """The button of a plot copies an address that shows the plot, with its scenario open and its legend."""
    opened.context.grant_permissions(["clipboard-read", "clipboard-write"])
    opened.get_by_label("others in grey").uncheck()
    plot = "section.scenario:nth-of-type(2) figure:has([data-plot=error])"
    opened.evaluate(
        "() => document.querySelectorAll('section.scenario > details').forEach(p => p.open = true)"
    )
    figure = opened.locator(plot)
    figure.get_by_role("button", name="link").click()
    address = opened.evaluate("() => navigator.clipboard.readText()")
    opened.goto("about:blank")
    opened.goto(address)
    expect(figure.locator("[data-plot][data-drawn]")).to_be_in_viewport()
    expect(figure).to_have_class("linked")
    assert not opened.get_by_label("others in grey").is_checked()


@pytest.mark.nightly
def test_the_axes_span_the_selected_lines(opened: Page) -> None:
    """With the reference in grey the axis ends at the engine's errors; with it selected, at its own."""
    draw_all(opened)
    decades = """() => {
      const { range } = document.querySelector("section.scenario [data-plot=error]")._fullLayout.yaxis;
      return range[1] - range[0];
    }"""
    engine = opened.evaluate(decades)
    opened.get_by_role("checkbox", name="reference", exact=True).check()
    assert opened.evaluate(decades) > engine + 1.0


def test_the_page_of_a_run_is_short(opened: Page) -> None:
    """With every scenario folded, the default for many scenarios, the page is at most 4,000 px high."""
    opened.evaluate(
        "() => document.querySelectorAll('section.scenario > details').forEach(part => part.open = false)"
    )
    assert opened.evaluate("() => document.documentElement.scrollHeight") <= 4000


def test_a_mark_of_the_heat_map_leads_to_its_cell(opened: Page) -> None:
    """A click, or Enter, on a mark opens the details of its cell and scrolls them into view."""
    opened.get_by_label("the reference’s own methods").check()
    marks = opened.locator("#heat td a")
    for number, act in ((3, "click"), (-2, "press")):
        mark = marks.nth(number)
        target = opened.locator(f"[id='{(mark.get_attribute('href') or '').removeprefix('#')}']")
        expect(target.locator(".cases")).to_be_hidden()
        mark.focus()
        mark.click() if act == "click" else opened.keyboard.press("Enter")
        expect(target.locator(".cases")).to_be_visible()
        expect(target.locator("summary")).to_be_in_viewport()
        name = unquote((mark.get_attribute("href") or "").rpartition("--")[2])
        expect(target.locator("summary b")).to_have_text(name)


def test_a_link_to_a_cell_opens_it(opened: Page, report_file: Path) -> None:
    """The address of a cell, as sent to a colleague, shows the cell open."""
    target = opened.locator("#heat td a").first.get_attribute("href")
    opened.goto("about:blank")
    opened.goto(report_file.as_uri() + str(target))
    expect(opened.locator("details.cell[open] .cases")).to_be_visible()


@pytest.mark.nightly
def test_the_copy_button_takes_the_command(opened: Page) -> None:
    """The copied text is the command of this case."""
    opened.context.grant_permissions(["clipboard-read", "clipboard-write"])
    draw_all(opened)  # a plot drawn during a click would move the page
    opened.locator("details.parts > summary").first.click()
    cell = opened.locator("details.cell").first
    cell.locator("summary").click()
    row = cell.locator(".cases td:last-child").last
    row.get_by_role("button").click()
    expect(row.get_by_role("button")).to_have_text("copied")
    assert opened.evaluate("() => navigator.clipboard.readText()") == row.locator("code").inner_text()


def picture(page: Page) -> str:
    """Return the picture of the last track of the first motion as text."""
    shown: str = page.evaluate(
        "() => [...document.querySelector('.tracks').querySelectorAll('canvas')].at(-1).toDataURL()"
    )
    return shown


@pytest.mark.nightly
def test_dark_mode_redraws_everything(opened: Page) -> None:
    """In dark mode the page has a dark background, and plots and motions are redrawn in matching colours."""
    draw_all(opened)
    ink = "() => document.querySelector('[data-plot=speed]').layout.font.color"
    light, shown = opened.evaluate(ink), picture(opened)
    opened.emulate_media(color_scheme="dark")
    opened.wait_for_function(f"before => ({ink})() !== before", arg=light)
    assert picture(opened) != shown
    assert opened.evaluate("() => getComputedStyle(document.body).backgroundColor") == "rgb(22, 24, 28)"


CUT = """() => {
  const clipped = element => {
    for (let outer = element.parentElement; outer; outer = outer.parentElement) {
      if (getComputedStyle(outer).overflowX !== "visible") return true;
    }
    return false;
  };
  return [...document.querySelectorAll("body *")]
    .filter(element => element.getClientRects().length && !clipped(element) && !element.closest(".skip, svg"))
    .filter(element => element.getBoundingClientRect().right > innerWidth + 1)
    .map(element => element.tagName + " " + element.className);
}"""
OVERLAPS = """() => {
  const parts = "main > section > *, section.scenario > details > *, .plots > *, .tracks > *";
  const boxes = [...document.querySelectorAll(parts)]
    .filter(element => element.tagName !== "SCRIPT" && element.getClientRects().length)
    .map(element => [element, element.getBoundingClientRect()]);
  return boxes.flatMap(([a, p], i) => boxes.slice(i + 1)
    .filter(([b, q]) => a.parentElement === b.parentElement)
    .filter(([, q]) => Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1
      && Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 1)
    .map(([b]) => a.className + " | " + b.className));
}"""


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("width", [360, pytest.param(768, marks=pytest.mark.nightly), 1440])
def test_nothing_is_cut_or_overlaps(opened: Page, width: int) -> None:
    """At the widths of a phone, a tablet and a desktop the page fits the window and parts do not overlap."""
    draw_all(opened, width)
    assert opened.evaluate("() => document.documentElement.scrollWidth") == width
    assert opened.evaluate(CUT) == []
    assert opened.evaluate(OVERLAPS) == []


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("width", [390, 768])
def test_a_stacked_answer_names_its_columns(opened: Page, width: int) -> None:
    """Where the heads of the cheapest settings are hidden, each cell begins with its own."""
    opened.set_viewport_size({"width": width, "height": 600})
    assert not opened.locator(".answers thead").is_visible()
    labels = opened.locator(".answers tr:not(.missed) td").evaluate_all(
        "cells => cells.map(cell => getComputedStyle(cell, '::before').content)"
    )
    assert labels
    assert [label for label in labels if ": " not in label] == []


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("width", [390, 1200])
def test_drawing_moves_nothing(opened: Page, width: int) -> None:
    """A figure has its size before it is drawn, so that no click misses its target and no line its reader."""
    opened.set_viewport_size({"width": width, "height": 600})
    places = """() => [...document.querySelectorAll("section, figure, canvas")]
      .map(element => Math.round(element.getBoundingClientRect().top + scrollY))"""
    assert opened.locator("[data-motion][data-drawn]").count() == 0
    before = opened.evaluate(places)
    draw_all(opened, width)
    assert opened.evaluate(places) == before


def test_every_control_can_be_reached_by_keys(opened: Page) -> None:
    """Links, buttons, boxes, selects, sliders and details take the focus, each with an accessible name."""
    controls = opened.locator("a[href], button, input, select, summary, .scroll")
    assert controls.count() > 50
    unnamed = controls.evaluate_all(
        """all => all.filter(control => {
          const label = control.closest("label")?.textContent ?? "";
          const name = control.getAttribute("aria-label") ?? control.textContent + label;
          return control.tabIndex < 0 || !name.trim();
        }).map(control => control.outerHTML.slice(0, 80))"""
    )
    assert unnamed == []


@pytest.mark.nightly
def test_plots_wait_until_they_are_seen_or_printed(opened: Page) -> None:
    """Plots far below the window are not drawn when the page opens, but are drawn before it is printed."""
    opened.evaluate("() => new Promise(seen => new IntersectionObserver(seen).observe(document.body))")
    assert opened.locator("[data-plot][data-drawn]").count() < PLOTS
    opened.emulate_media(media="print")
    opened.evaluate("() => dispatchEvent(new Event('beforeprint'))")
    expect(opened.locator("[data-plot][data-drawn]")).to_have_count(PLOTS)
    expect(opened.locator("[data-motion][data-drawn]")).to_have_count(SECTIONS)


def test_an_idle_page_draws_what_nobody_has_seen(opened: Page) -> None:
    """After the idle callbacks a picture of the whole page has every plot and motion."""
    opened.evaluate("() => window.idle.forEach(call => call())")
    assert opened.locator("[data-plot][data-drawn]").count() == PLOTS
    assert opened.locator("[data-motion][data-drawn]").count() == SECTIONS
