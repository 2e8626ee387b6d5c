"""The web page, opened in headless Chromium: it draws, turns, fits, and asks nobody for anything."""

import base64
import io
import json
import re
import zlib

import numpy as np
import pytest
from browser import chromium, until
from PIL import Image

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea, SinusoidalSea
from meshtrace.viz import page as web

LINK = mt.Link(receiver=mt.Receiver(tilt_deg=10.0), bubbles=mt.HallNovarini(wind_speed=5.0))


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "scene.html"
    coverage = mt.CoverageMap(*2 * [np.linspace(-2.0, 2.0, 5)], *2 * [np.ones((5, 5))], {})
    return viz.save_html(
        LINK, JonswapSea(seed=7), path, paths=60, received=5, coverage=coverage, title="a <link>"
    )


@pytest.fixture(scope="module")
def browser(page):
    with chromium(640, 520) as driver:
        driver.get(page.as_uri())
        until(lambda: colors(driver) > 200, "the page stays empty")
        yield driver


@pytest.fixture(scope="module")
def low_sun(tmp_path_factory):
    day = mt.Daylight.clear_sky(sun_zenith_deg=75.0)
    path = tmp_path_factory.mktemp("day") / "low.html"
    return viz.save_html(mt.Link(), JonswapSea(wind_speed=3.0, seed=7), path, daylight=day)


def parts_of(path):
    text = re.search(r'id="data">([^<]*)<', path.read_text("utf-8"))[1]
    return json.loads(zlib.decompress(base64.b64decode(text)))


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
@pytest.mark.parametrize(
    ("width", "height", "scheme"), [(390, 844, "light"), (768, 1024, "dark"), (1440, 900, "light")]
)
def test_it_fits_every_screen(browser, page, width, height, scheme):
    """The caption once covered the scene of a phone; a page of a blank canvas has few colours."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    try:
        browser.get(page.as_uri())
        until(lambda: colors(browser) > 500, "the scene stays empty")
        overflow, main, about, back = browser.execute_script(
            """const e = document.documentElement, box = (s) => document.querySelector(s).getBoundingClientRect();
               return [[e.scrollWidth - e.clientWidth, e.scrollHeight - e.clientHeight],
                       box("canvas").bottom, box("#about").top, getComputedStyle(document.body).backgroundColor];"""
        )
        scene = picture(browser)[80 : int(main)]
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {})
    assert overflow == [0, 0]
    assert main > 0.5 * height
    assert about >= main  # words below the scene, not on it
    assert (sum(map(int, re.findall(r"\d+", back)[:3])) > 380) == (scheme == "light")
    levels, counts = np.unique(scene.reshape(-1, 3), axis=0, return_counts=True)
    assert counts.max() < 0.3 * counts.sum()
    assert len(levels) > 500


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
    text = browser.find_element("tag name", "body").text
    for words in (
        "a <link>",
        "channel gain 0",
        "bubbles, 0.0",
        "unscattered light received",
        "Drag or arrow keys",
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
    # that of "rendering" is of the software that draws for WebGL
    assert [line for line in browser.get_log("browser") if line["source"] != "rendering"] == []


def test_it_is_small_and_has_the_parts_of_the_scene(page):
    assert page.stat().st_size < 3_000_000
    parts = parts_of(page)
    rays = np.frombuffer(base64.b64decode(parts["rays"]["base64"]), np.float32).reshape(-1, 7)
    assert 2.0 in rays[:, 6]  # photons that landed elsewhere
    assert min(rays[:, 6]) < 2.0  # received light
    assert len(parts["dots"]["base64"]) > 1000
    assert parts["map"]["n"] == 5


def test_large_meshes_are_thinned_and_the_page_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(web, "_MOST_FACETS", 2_000)
    mesh = SinusoidalSea(amplitude=0.3, wavelength=6.0).mesh(extent=4.0, spacing=0.2)
    style = viz.SceneStyle(color="slope", edges=True)
    path = viz.save_html(None, mesh, tmp_path / "a.html", style=style)
    faces = np.frombuffer(base64.b64decode(parts_of(path)["faces"]["base64"]), np.uint32)
    assert len(faces) // 3 <= 2_000 < len(mesh.faces)
    text = path.read_text("utf-8")
    assert f"thinned from {len(mesh.faces):,} to {len(faces) // 3:,} facets" in text
    assert "not in this page: edges of the facets" in text
    assert "slope of the surface" in text


def test_only_pages_are_written(tmp_path):
    with pytest.raises(ValueError, match=r"path: .*allowed: a file name in \.html"):
        viz.save_html(LINK, JonswapSea(seed=7), tmp_path / "scene.png")


@pytest.mark.browser
@pytest.mark.parametrize("turn", [-23.0, 0.0, 90.0, 180.0])  # from home; the first is to the sun
def test_the_sea_under_a_low_sun_is_not_burnt_out(browser, low_sun, turn):
    """By an exponential tone curve 7 to 9 % of sea and sky were white."""
    browser.get(low_sun.as_uri())
    scene = "document.querySelector('#scene')._vnode?.component?.proxy"
    until(lambda: browser.execute_script(f"return Boolean({scene}?.view)"), "no scene")
    browser.execute_script(f"{scene}.move({{ azimuth: arguments[0] }}); {scene}.paint(1)", turn)
    url = browser.execute_script("return document.querySelector('canvas').toDataURL()")
    image = Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGB")
    upper = np.asarray(image)[: image.height // 2]  # sea and sky; the lower half is deep water
    assert (upper.max(axis=2) >= 253).mean() < 0.01
    assert upper.mean() > 60.0
