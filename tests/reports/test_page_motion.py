"""The motion in a browser: time, cases, views, and the plots that share its time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Error, Locator, Page, expect

from bodycheck.reports.render.page.played_motions import shown_cases
from bodycheck.reports.run_files.run_tables import Run, coarsest_shared_step, key_of
from tests.helpers.markup_run import HOSTILE

pytestmark = pytest.mark.slow

LONG_MS = 120_000


@pytest.fixture
def opened(chromium: Browser, report_file: Path) -> Iterator[Page]:
    """Return the report with the first motion drawn; an error in a script fails the test."""
    page = chromium.new_page(viewport={"width": 1200, "height": 6000})
    page.set_default_timeout(LONG_MS)
    errors: list[Error] = []
    page.on("pageerror", lambda error: errors.append(error))
    page.goto(report_file.as_uri())
    expect(page.locator("[data-motion][data-drawn]").first).to_be_visible()
    yield page
    assert errors == []
    page.close()


@pytest.fixture
def figure(opened: Page) -> Locator:
    """Return the first motion."""
    return opened.locator("[data-motion]").first


def pictures(figure: Locator) -> list[str]:
    """Return the picture of each track as text."""
    shown: list[str] = figure.locator("canvas").evaluate_all("all => all.map(one => one.toDataURL())")
    return shown


def angles(figure: Locator) -> list[float]:
    """Return the distances from the truth that the engines' panels show, in rad."""
    reported = figure.locator(".tracks small").all_inner_texts()[1:]
    return [float(text.removesuffix(" rad off").rpartition(", ")[2]) for text in reported]


def set_time(figure: Locator, share: float) -> None:
    """Move the slider to a fraction of the duration."""
    figure.get_by_label("Time").fill(str(round(1000 * share)))


@pytest.mark.nightly
def test_the_motion_opens_where_it_is_farthest_from_the_truth(figure: Locator, run: Run) -> None:
    """The caption names case, time and distance; play begins at 0; each panel shows the error of its case."""
    cases = [case for case in run.cases if case.columns["scenario"] == HOSTILE]
    shown = shown_cases(cases, coarsest_shared_step(cases))
    series = [case.series["orientation_error_rad"] for case in shown]
    worst = max(range(len(shown)), key=lambda k: series[k].max())
    at_s = run.problems[0].times[series[worst].argmax()]
    expect(figure.locator("output")).to_have_text(f"{at_s:.2f} s")
    caption = figure.locator("figcaption")
    for part in (f"{at_s:.2f} s", ":".join(key_of(shown[worst].columns)), f"{series[worst].max():.2g} rad"):
        expect(caption).to_contain_text(part)
    figure.locator("[data-play]").click()
    figure.page.wait_for_function(
        "([figure, t]) => parseFloat(figure.dataset.drawn) < t", arg=[figure.element_handle(), float(at_s)]
    )
    for share, k in ((1.0, -1), (0.5, (len(series[0]) - 1) // 2)):
        set_time(figure, share)
        assert angles(figure) == pytest.approx([own[k] for own in series], rel=0.06)


def test_the_motion_follows_its_slider_and_its_button(opened: Page, figure: Locator) -> None:
    """Keys and the play button change the time, pause stops it, and the picture follows."""
    slider, clock = figure.get_by_label("Time"), figure.locator("output")
    assert figure.locator("canvas").count() == 3  # the truth and one case of each of two engines
    slider.focus()
    opened.keyboard.press("Home")
    expect(clock).to_have_text("0.00 s")
    at_first = pictures(figure)
    opened.keyboard.press("End")
    expect(clock).to_have_text("1.00 s")
    assert all(now != first for now, first in zip(pictures(figure), at_first, strict=True))
    opened.keyboard.press("Home")
    assert pictures(figure) == at_first
    button = figure.locator("[data-play]")
    button.press("Enter")
    expect(button).to_have_text("pause")
    expect(clock).not_to_have_text("0.00 s")
    button.press("Enter")
    expect(button).to_have_text("play")
    stopped = clock.inner_text()
    opened.evaluate("() => new Promise(seen => requestAnimationFrame(() => requestAnimationFrame(seen)))")
    assert clock.inner_text() == stopped


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("loops", [False, True])
def test_a_motion_stops_at_its_end_unless_it_loops(loops: bool, figure: Locator) -> None:
    """At the end the motion stops, or starts again if it loops."""
    figure.get_by_label("speed").select_option("4")
    figure.get_by_label("loop").set_checked(loops)
    set_time(figure, 0.95)
    button = figure.locator("[data-play]")
    button.click()
    if loops:
        figure.page.wait_for_function(
            "figure => parseFloat(figure.dataset.drawn) < 0.5", arg=figure.element_handle()
        )
        expect(button).to_have_text("pause")
        button.click()
    else:
        expect(button).to_have_text("play")
        expect(figure.locator("output")).to_have_text("1.00 s")


def test_any_case_can_be_chosen(figure: Locator, run: Run) -> None:
    """A panel shows the error of the chosen method and step, and only its own picture changes."""
    set_time(figure, 1.0)
    panel = figure.get_by_label("Motion in panel 1")
    before = pictures(figure)
    errors = {
        f"{c.columns['engine']}:{c.columns['method']}, dt {c.dt_s} s": c.columns[
            "orientation_error_final_rad"
        ]
        for c in run.cases
        if c.columns["scenario"] == HOSTILE and c.ok
    }
    labels = panel.locator("option").all_inner_texts()
    assert len(labels) > 4
    for label in labels[:: len(labels) // 4]:
        panel.select_option(label=label)
        assert angles(figure)[0] == pytest.approx(errors[label], rel=0.06, abs=1e-17)
    panel.select_option(label=min(labels, key=lambda label: errors[label]))
    changed = [now != then for now, then in zip(pictures(figure), before, strict=True)]
    assert changed == [False, True, False]


def test_mouse_and_keys_rotate_the_views(opened: Page, figure: Locator) -> None:
    """All panels share one viewpoint; dragging there and back restores the first picture."""
    before = pictures(figure)
    canvas = figure.locator("canvas").nth(1)
    canvas.focus()
    opened.keyboard.press("ArrowRight")
    rotated = pictures(figure)
    assert all(now != then for now, then in zip(rotated, before, strict=True))
    opened.keyboard.press("ArrowLeft")
    place = canvas.bounding_box()
    assert place
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 4
    opened.mouse.move(x, y)
    opened.mouse.down()
    opened.mouse.move(x + 40, y)
    dragged = pictures(figure)
    assert all(now != then for now, then in zip(dragged, before, strict=True))
    opened.mouse.up()
    opened.mouse.move(x, y)
    assert pictures(figure) == dragged
    opened.keyboard.press("Space")
    expect(figure.locator("[data-play]")).to_have_text("pause")


@pytest.mark.nightly
def test_a_link_opens_its_time(opened: Page, figure: Locator) -> None:
    """The copied address shows the motion at the time at which it was copied."""
    opened.context.grant_permissions(["clipboard-read", "clipboard-write"])
    set_time(figure, 0.25)
    figure.get_by_role("button", name="link to this time").click()
    address = opened.evaluate("() => navigator.clipboard.readText()")
    opened.goto("about:blank")
    opened.goto(address)
    expect(figure.locator("output")).to_have_text("0.25 s")
    expect(figure.locator("canvas").first).to_be_in_viewport()


POINT = """() => {
  const plot = document.querySelector("[data-plot=drift]");
  const trace = plot.data.find(({ name, hoverinfo }) => name?.includes("sound") && hoverinfo === "text");
  const k = Math.round(0.4 * (trace.x.length - 1));
  const { left, top } = plot.getBoundingClientRect();
  const { xaxis, yaxis } = plot._fullLayout;
  const [x, y] = [trace.x[k], trace.y[k]];
  return [left + xaxis._offset + xaxis.d2p(x), top + yaxis._offset + yaxis.d2p(y), x];
}"""


@pytest.mark.nightly
def test_a_click_at_an_error_shows_the_body_at_that_time(opened: Page, figure: Locator) -> None:
    """Plot, body and address share the time, and a panel shows the line's case; the address restores it."""
    expect(opened.locator("[data-plot=drift][data-drawn]").first).to_be_visible()
    x, y, t = opened.evaluate(POINT)
    opened.mouse.move(x, y)
    expect(opened.locator("[data-plot=drift] .hoverlayer .hovertext").first).to_be_visible()
    opened.mouse.click(x, y)
    clock = figure.locator("output")
    expect(clock).to_have_text(f"{t:.2f} s")
    chosen = figure.locator(".tracks select option:checked").all_inner_texts()
    assert any(":sound, dt " in label for label in chosen)
    cursor = opened.locator("[data-plot=drift] > .cursor").first
    place, x_now = cursor.bounding_box(), opened.evaluate(POINT)[0]
    assert place
    assert place["x"] == pytest.approx(x_now, abs=1.5)
    address = opened.url
    opened.goto("about:blank")
    opened.goto(address)
    expect(clock).to_have_text(f"{t:.2f} s")


@pytest.mark.nightly
def test_the_cursor_of_a_plot_follows_the_slider(opened: Page, figure: Locator) -> None:
    """At half the time the cursor is in the middle of the axis, also after the plot is drawn again."""
    expect(opened.locator("[data-plot=drift][data-drawn]").first).to_be_visible()
    set_time(figure, 0.5)
    middle = """() => {
      const plot = document.querySelector("[data-plot=drift]");
      const { xaxis } = plot._fullLayout;
      return plot.getBoundingClientRect().left + xaxis._offset + xaxis.d2p(0.5);
    }"""
    cursor = opened.locator("[data-plot=drift] > .cursor").first
    for quantity in ("energy_drift", "omega_error"):
        opened.locator("select[data-choice=drift]").first.select_option(quantity)
        place = cursor.bounding_box()
        assert place
        assert place["x"] == pytest.approx(opened.evaluate(middle), abs=1.5)
