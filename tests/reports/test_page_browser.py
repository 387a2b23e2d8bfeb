"""The page in a browser: every plot drawn, every control at work, nothing cut, light and dark, on paper."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import pytest
from odd_run import HOSTILE
from playwright.sync_api import Browser, Error, Page, expect

from bodycheck.reports.render.page.motion import coarsest_shared_step, shown_cases
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.templating import asset

pytestmark = pytest.mark.slow

LONG_MS = 120_000
SECTIONS = 2
PLOTS = 3 * SECTIONS + 1


@pytest.fixture
def opened(chromium: Browser, report_file: Path) -> Iterator[Page]:
    """Return the report in a window of its own; a script that failed fails the test."""
    page = chromium.new_page(viewport={"width": 1200, "height": 600})
    page.set_default_timeout(LONG_MS)
    errors: list[Error] = []
    page.on("pageerror", lambda error: errors.append(error))
    page.goto(report_file.as_uri())
    yield page
    assert errors == []
    page.close()


def draw_all(page: Page, width: int = 1200) -> None:
    """Make the window as tall as the page, so that all of it is in view, and wait until it is drawn."""
    page.set_viewport_size({"width": width, "height": 25_000})
    expect(page.locator("[data-plot][data-drawn]")).to_have_count(PLOTS)
    expect(page.locator("[data-motion][data-drawn]")).to_have_count(SECTIONS)


def test_the_browser_draws_every_plot(opened: Page) -> None:
    """All plots in view have their lines, and a name with markup is text in a label."""
    draw_all(opened)
    assert opened.locator("g[class^='trace scatter']").count() > PLOTS * 10
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
    """It has 1, 2 and 5 of each decade as numbers; one of more decades has its powers, as without points."""
    page = chromium.new_page()
    looks = f"const colour = () => '#000'; {asset('templates/looks.js')}"
    texts = f"all => {{ {looks} return all.map(values => logAxis('', values).ticktext ?? []); }}"
    steps, finer, many, none = page.evaluate(texts, [[1e-3, 1e-2], [2e-5, 5e-5], [1e-5, 1e-2], []])
    page.close()
    assert {"0.001", "0.002", "0.005", "0.01"} <= set(steps)
    assert {"2e-5", "5e-5"} <= set(finer)
    assert many == none == []


def test_what_failed_stands_at_the_edge_of_the_speed_plot(opened: Page) -> None:
    """Marks of failed, invalid and unstable cases stand beside the axes; markup in a label is text."""
    draw_all(opened)
    texts = opened.evaluate(
        """() => document.querySelector("[data-plot=speed]").data
          .filter(trace => trace.xaxis === "x2").map(trace => trace.text)"""
    )
    told = " ".join(texts)
    assert all(word in told for word in ("failed", "invalid", "unstable"))
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
    assert sum("not measured" in str(text) for text in overall) == 4


def test_a_choice_of_error_changes_plots_and_tables(opened: Page) -> None:
    """The plots are drawn against the error that is chosen, and its table is the one that is shown."""
    draw_all(opened)
    section = opened.locator("section.scenario").first
    section.locator("details:has(.cheapest) > summary").click()
    for error in ("energy_drift", "orientation_error_rad"):
        section.locator("select[data-choice=error]").select_option(error)
        expect(section.locator("[data-plot=speed] .ytitle")).to_contain_text(error)
        expect(section.locator("[data-plot=error] .ytitle")).to_contain_text(error)
        assert section.locator("[data-error]:visible").evaluate_all(
            "all => all.map(one => one.dataset.error)"
        ) == [error]


def test_the_legend_takes_lines_away(opened: Page) -> None:
    """A line whose box is cleared is gone from the plots, and back when it is checked again."""
    draw_all(opened)
    section = opened.locator("section.scenario").first
    lines = "() => document.querySelector('section.scenario [data-plot=drift]').data.length"
    all_lines = opened.evaluate(lines)
    box = section.get_by_role("checkbox", name="reference:rk4")
    box.uncheck()
    assert opened.evaluate(lines) == all_lines - 1
    section.get_by_role("button", name="none").click()
    assert opened.evaluate(lines) == 0
    section.get_by_role("button", name="all").click()
    assert opened.evaluate(lines) == all_lines
    expect(box).to_be_checked()


def test_a_mark_of_the_heat_map_leads_to_its_cell(opened: Page) -> None:
    """A click, or Enter, on a mark opens the part of that very cell and brings it into view."""
    marks = opened.locator(".heat td a")
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
    """The address of a cell, as one sends it to a colleague, shows the cell open."""
    target = opened.locator(".heat td a").first.get_attribute("href")
    opened.goto("about:blank")
    opened.goto(report_file.as_uri() + str(target))
    expect(opened.locator("details.cell[open] .cases")).to_be_visible()


def test_the_copy_button_takes_the_command(opened: Page) -> None:
    """What is copied is the command of that very case."""
    opened.context.grant_permissions(["clipboard-read", "clipboard-write"])
    cell = opened.locator("details.cell").first
    cell.locator("summary").click()
    row = cell.locator(".command").last
    row.get_by_role("button").click()
    expect(row.get_by_role("button")).to_have_text("copied")
    assert opened.evaluate("() => navigator.clipboard.readText()") == row.locator("code").inner_text()


def picture(page: Page) -> str:
    """Return what the last track of the first motion shows, as the text of a picture."""
    shown: str = page.evaluate(
        "() => [...document.querySelector('.tracks').querySelectorAll('canvas')].at(-1).toDataURL()"
    )
    return shown


def test_the_motion_follows_its_slider_and_its_button(opened: Page, run: Run) -> None:
    """The time moves by keys and by play, stops at pause, and the picture and the angle move with it."""
    draw_all(opened)
    figure = opened.locator("[data-motion]").first
    slider, clock = figure.get_by_label("Time"), figure.locator("output")
    assert figure.locator("canvas").count() == 3  # the truth and one method of each of two engines
    at_first = picture(opened)
    slider.focus()
    opened.keyboard.press("End")
    expect(clock).to_have_text("1.00 s")
    assert picture(opened) != at_first
    cases = [case for case in run.cases if case.columns["scenario"] == HOSTILE]
    ends = [c.columns["orientation_error_final_rad"] for c in shown_cases(cases, coarsest_shared_step(cases))]
    assert max(ends) > 1e-3
    for text, end in zip(figure.locator(".tracks small").all_inner_texts()[1:], ends, strict=True):
        told = text.removesuffix(" rad off").removeprefix("less than ")
        assert float(told) == pytest.approx(max(end, 1e-6), rel=0.06)
    opened.keyboard.press("Home")
    expect(clock).to_have_text("0.00 s")
    assert picture(opened) == at_first
    button = figure.get_by_role("button")
    button.press("Enter")
    expect(button).to_have_text("pause")
    expect(clock).not_to_have_text("0.00 s")
    button.press("Enter")
    expect(button).to_have_text("play")
    stopped = clock.inner_text()
    opened.evaluate("() => new Promise(seen => requestAnimationFrame(() => requestAnimationFrame(seen)))")
    assert clock.inner_text() == stopped


def test_dark_mode_redraws_everything(opened: Page) -> None:
    """In the dark the paper is dark, and plots and motions are drawn anew in colours for it."""
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
  const boxes = [...document.querySelectorAll("main > section > *, .plots > *, .tracks > *")]
    .filter(element => element.tagName !== "SCRIPT" && element.getClientRects().length)
    .map(element => [element, element.getBoundingClientRect()]);
  return boxes.flatMap(([a, p], i) => boxes.slice(i + 1)
    .filter(([b, q]) => a.parentElement === b.parentElement)
    .filter(([, q]) => Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1
      && Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 1)
    .map(([b]) => a.className + " | " + b.className));
}"""


@pytest.mark.parametrize("width", [360, 768, 1440])
def test_nothing_is_cut_or_overlaps(opened: Page, width: int) -> None:
    """At the width of a phone, a tablet and a desk the page is as wide as the window; parts stand apart."""
    draw_all(opened, width)
    assert opened.evaluate("() => document.documentElement.scrollWidth") == width
    assert opened.evaluate(CUT) == []
    assert opened.evaluate(OVERLAPS) == []


def test_every_control_can_be_reached_by_keys(opened: Page) -> None:
    """Links, buttons, boxes, selects, sliders and parts all take the focus, each with a name to say."""
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


def test_plots_wait_until_they_are_seen_or_printed(opened: Page) -> None:
    """Plots far below the window are not drawn when the page opens, but are before it is printed."""
    opened.evaluate("() => new Promise(seen => new IntersectionObserver(seen).observe(document.body))")
    assert opened.locator("[data-plot][data-drawn]").count() < PLOTS
    opened.emulate_media(media="print")
    opened.evaluate("() => dispatchEvent(new Event('beforeprint'))")
    expect(opened.locator("[data-plot][data-drawn]")).to_have_count(PLOTS)
    expect(opened.locator("[data-motion][data-drawn]")).to_have_count(SECTIONS)
