"""The web page, opened in headless Chromium: it renders, turns, and asks nobody for anything."""

import io
import json

import numpy as np
import pytest
from browser import chromium, until
from PIL import Image

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "scene.html"
    link = mt.Link(receiver=mt.Receiver(tilt_deg=10.0), bubbles=mt.HallNovarini(wind_speed=5.0))
    style = viz.SceneStyle(color="elevation", spacing=0.5, off_screen=True)
    plotter = viz.scene(link, JonswapSea(seed=7), style=style)
    viz.save_html(plotter, path, title="a <link>")
    plotter.close()
    return path


@pytest.fixture(scope="module")
def browser(page):
    with chromium(640, 520) as driver:
        driver.get(page.as_uri())
        until(lambda: colors(driver) > 200, "the page stays empty")
        yield driver


def picture(driver):
    return np.asarray(Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB"))


def colors(driver):
    return len(np.unique(picture(driver).reshape(-1, 3), axis=0))


def drag(driver):
    """Drag across the scene in quick small steps, as a hand does."""
    from selenium.webdriver import ActionChains

    canvas = driver.find_element("tag name", "canvas")
    chain = ActionChains(driver, duration=5).move_to_element(canvas).click_and_hold()
    for _ in range(12):
        chain.move_by_offset(6, 2)
    chain.release().perform()


@pytest.mark.browser
def test_it_renders(browser):
    image = picture(browser).astype(int)
    sea = (image[..., 2] > image[..., 0] + 30).mean()
    assert sea > 0.05


@pytest.mark.browser
@pytest.mark.thorough
def test_it_reacts_to_the_mouse(browser):
    before = picture(browser).astype(int)

    def turned():
        drag(browser)
        return (np.abs(picture(browser).astype(int) - before).sum(axis=2) > 30).mean() > 0.02

    until(turned, "the scene does not turn")


@pytest.mark.browser
def test_it_explains_itself(browser):
    text = browser.find_element("id", "about").text
    for words in (
        "a <link>",
        "sea surface elevation [m]",
        "bubbles",
        "drag to turn",
        "JONSWAP sea, wind 5 m/s, seed 7",
    ):
        assert words in text


@pytest.mark.browser
def test_it_needs_no_network_and_logs_no_error(browser, page):
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = {
        m["params"]["request"]["url"]
        for m in messages
        if m["method"] == "Network.requestWillBeSent"
    }
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {page.as_uri()}
    problems = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert problems == []


@pytest.mark.thorough
def test_only_pages_are_written(tmp_path):
    plotter = viz.scene(
        mt.Link(), JonswapSea(seed=7), style=viz.SceneStyle(spacing=1.0, off_screen=True)
    )
    with pytest.raises(ValueError, match=r"path: .*allowed: a file name in \.html"):
        viz.save_html(plotter, tmp_path / "scene.png")
    plotter.close()
