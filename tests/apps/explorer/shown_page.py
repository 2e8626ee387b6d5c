"""The page of the explorer in a browser: what tests enter, read and wait for."""

import io
import re
import warnings
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from browser import until
from PIL import Image

import meshtrace as mt
from meshtrace.apps.explorer import controls, stages
from meshtrace.scenario import Scenario

PAPER = Scenario.from_toml("")


def opened(driver, url):
    driver.get(url)
    until(lambda: driver.find_elements("id", "gain"), "no page")
    until(lambda: reading(driver) is not None, "no gain", 180.0)


def sized(driver, width, height, dark=False):
    """Show the page as in a window of a size [px] of a system with light or dark colours."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 800}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})


def shown(driver, name):
    found = driver.find_elements("id", name)
    return found[0].get_property("value") if found else None


def enter(driver, name, value):
    """Enter a value in a field, as typing and leaving it does."""
    driver.execute_script(
        "const e = document.getElementById(arguments[0]); e.value = arguments[1];"
        "e.dispatchEvent(new Event('change'))",
        name,
        value,
    )


def reading(driver):
    """Return the gain that the page shows as its answer to the present state, or None."""
    gain = driver.find_element("id", "gain")
    stale = "mt-faded" in gain.find_element("xpath", "..").get_attribute("class")
    value = gain.get_attribute("data-value")
    return None if stale or value is None else float(value)


def idle(driver):
    return driver.find_element("id", "status").text == "up to date"


@cache
def begun():
    """Return the time at which the page begins."""
    return stages.quiet_time(PAPER)


def gain_is(driver, moves, time=None):
    """Return whether the page shows the refined gain of a state, from a run of the library."""
    time = begun() if time is None else time
    expected = expected_gain(tuple(sorted(moves.items())), time)
    return reading(driver) == pytest.approx(expected, rel=1e-12)


def expected_gain(moves, time, known={}):  # noqa: B006
    if (moves, time) not in known:
        scenario = controls.State(PAPER).moved(dict(moves)).scenario
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the page shows them as notes
            known[moves, time] = mt.simulate(scenario, photons=stages.CHAINS[-1], time=time).gain
    return known[moves, time]


def picture(driver, selector):
    shot = driver.find_element("css selector", selector).screenshot_as_png
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def luminance(rgb):
    """Return the relative luminance of a CSS colour, of WCAG 2."""
    share = np.array([int(v) for v in re.findall(r"\d+", rgb)[:3]]) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def text_of(driver):
    """Return the text in the dialog."""
    read = "return document.getElementById('text')?.textContent ?? ''"
    return driver.execute_script(read)


def view_of(driver):
    return driver.execute_script("return {...trame.refs.scene.view}")


def axe():
    """Return the script of axe-core, which a package for tests holds."""
    found = find_spec("axe_core_python")
    if found is None:
        pytest.skip("needs axe-core: pip install axe-core-python")
    return Path(found.submodule_search_locations[0], "axe.min.js").read_text("utf-8")


def violations(page):
    """Return the rules that a page at rest violates, with their elements.

    Readings that are out of date are pale, on purpose.
    """
    pale = (
        "return [...document.querySelectorAll('.mt-faded, .mt-drag, .mt-chart')]"
        ".some((e) => getComputedStyle(e).opacity < 1)"
    )
    until(lambda: idle(page) and not page.execute_script(pale), "still at work", 180.0)
    page.execute_script(axe())
    page.set_script_timeout(120)
    run = (
        "axe.run(document).then((r) => arguments[0](r.violations.map("
        "(v) => [v.id, ...v.nodes.map((n) => n.html)])))"
    )
    return page.execute_async_script(run)
