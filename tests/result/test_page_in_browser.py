"""The page in a real browser: it draws, zooms, reads in dark and on a phone, and asks the network for nothing."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import result

from cosim.result.plots import Panel, Series
from cosim.result.report import Chart, Section, write_report
from cosim.result.run_report import report_run

SPIKE = 654_321


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A loop of a million rows whose command has a spike of one sample."""
    time = np.arange(1_000_000) * 1e-5
    reference = 5e-3 * np.sin(time)
    command = np.cos(time)
    command[SPIKE] = 42.0
    columns = {
        "t.position": (reference, "m"),
        "p.position": (reference + 1e-6 * np.sin(7.0 * time), "m"),
        "c.command": (command, "N.m"),
    }
    run = result(time, columns, connections=["t.position -> c.position_ref", "p.position -> c.position"])
    return report_run(run, tmp_path_factory.mktemp("page") / "run.html")


def opened(browser: Any, file: Path, **options: Any) -> tuple[Any, list[str], list[str]]:
    """The page when its charts are drawn, the addresses it asked for, and the errors it logged."""
    page = browser.new_page(**options)
    asked: list[str] = []
    errors: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-charts=drawn]", state="attached")
    return page, asked, errors


def wait_for(page: Any, condition: str) -> None:
    """Until a condition holds, at most 10 s. Playwright's own way of waiting breaks the page's security policy."""
    for _ in range(200):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    pytest.fail(f"never: {condition}")


def ranges(page: Any) -> list[list[float]]:
    script = "[...document.querySelectorAll('.panel')].map(p => [...p._fullLayout.xaxis.range])"
    return page.evaluate(script)


def test_page_is_drawn_without_errors_and_without_the_network(browser: Any, page_file: Path) -> None:
    page, asked, errors = opened(browser, page_file)
    assert page.locator("h1").inner_text() == "A stage <b>on</b> a table"
    assert page.locator("td", has_text="Position error, rms").count() == 1
    assert page.locator(".panel .scatterlayer .trace").count() == 4
    assert page.locator("svg .block").count() == 3
    assert errors == []
    assert [address for address in asked if not address.startswith(("file:", "data:", "blob:"))] == []
    page.close()


def test_spike_of_one_sample_is_on_the_screen(browser: Any, page_file: Path) -> None:
    page, _, _ = opened(browser, page_file)
    top = page.evaluate(
        "(() => { const y = document.querySelectorAll('.panel')[2].data[0].y; const k = y.indexOf(Math.max(...y));"
        " return [document.querySelectorAll('.panel')[2].data[0].x[k], y[k]]; })()"
    )
    assert top == [pytest.approx(SPIKE * 1e-5, rel=1e-12), 42.0]
    assert page.evaluate("document.querySelectorAll('.panel')[2]._fullLayout.yaxis.range[1]") > 42.0
    page.close()


def test_a_drag_zooms_all_panels_and_a_double_click_shows_all_again(browser: Any, page_file: Path) -> None:
    page, _, _ = opened(browser, page_file, viewport={"width": 1280, "height": 1400})
    before = ranges(page)
    assert before == [[pytest.approx(0.0), pytest.approx(9.99999)]] * 3
    box = page.locator(".panel").first.locator(".nsewdrag").bounding_box()
    middle = box["y"] + 0.5 * box["height"]
    page.mouse.move(box["x"] + 0.25 * box["width"], middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.50 * box["width"], middle, steps=5)
    page.mouse.up()
    wait_for(page, "document.querySelectorAll('.panel')[2]._fullLayout.xaxis.range[0] > 2.0")
    for found in ranges(page):
        assert found == [pytest.approx(2.5, abs=0.1), pytest.approx(5.0, abs=0.1)]
    # Two clicks count as a double click within 0.3 s, and a click soon after a drag counts with it: a busy machine may
    # need more than one attempt.
    for _ in range(10):
        page.wait_for_timeout(500)
        page.mouse.dblclick(box["x"] + 0.3 * box["width"], middle)
        page.wait_for_timeout(500)
        if ranges(page) == before:
            break
    assert ranges(page) == before
    page.close()


def test_page_follows_the_colours_of_the_reader(browser: Any, page_file: Path) -> None:
    page, _, _ = opened(browser, page_file, color_scheme="light")
    look = (
        "(() => { const p = document.querySelector('.panel'); return [getComputedStyle(document.body).backgroundColor,"
        " p._fullLayout.paper_bgcolor, p._fullData[0].line.color]; })()"
    )
    assert page.evaluate(look) == ["rgb(255, 255, 255)", "#fff", "#0072B2"]
    page.emulate_media(color_scheme="dark")
    wait_for(page, "document.querySelector('.panel')._fullLayout.paper_bgcolor === '#15191d'")
    assert page.evaluate(look) == ["rgb(21, 25, 29)", "#15191d", "#56A8DC"]
    page.close()


def test_buttons_send_nothing_and_save_a_picture(browser: Any, page_file: Path) -> None:
    page, _, _ = opened(browser, page_file)
    plot = page.locator(".panel").first
    plot.hover()
    titles = [button.get_attribute("data-title") for button in plot.locator(".modebar-btn").all()]
    assert [str(title).lower() for title in titles] == [
        "download plot as a png",
        "zoom",
        "pan",
        "zoom in",
        "zoom out",
        "autoscale",
    ]
    with page.expect_download() as download:
        plot.locator(".modebar-btn").first.click()
    assert Path(download.value.path()).read_bytes().startswith(b"\x89PNG")
    page.close()


def test_ticks_of_logarithmic_axes_are_powers_of_ten(browser: Any, tmp_path: Path) -> None:
    x = np.geomspace(0.2, 3000.0, 50)
    panel = Panel("density", "1", (Series("a", x, 1e-2 * x),), log=True)
    file = write_report(
        tmp_path / "log.html", "Log", [Section("S", [Chart([panel], "", "Frequency", "Hz", log_x=True)])]
    )
    page, _, errors = opened(browser, file)
    for axis, powers in (("x", range(4)), ("y", range(-2, 2))):
        shown = page.evaluate(f"[...document.querySelectorAll('.{axis}tick text')].map(t => t.innerHTML)")
        ends = [re.search(r">([\u2212\d]+)</tspan>", text) for text in shown if text.startswith("10")]
        assert len(ends) == len(shown) == len(powers), shown
        assert sorted(int(end[1].replace("\u2212", "-")) for end in ends if end) == list(powers)
    assert errors == []
    page.close()


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_sticks_out_sideways(browser: Any, page_file: Path, width: int) -> None:
    page, _, _ = opened(browser, page_file, viewport={"width": width, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") == width
    for plot in page.locator(".panel").all():
        box = plot.bounding_box()
        assert box["x"] >= 0.0
        assert box["x"] + box["width"] <= width
    page.close()
