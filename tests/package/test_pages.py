"""The built pages in headless Chromium at the widths of a phone, a tablet and a desk."""

from pathlib import Path

import pytest
from browser import chromium

HTML = Path(__file__).parents[2] / "docs" / "_build" / "html"
WIDTHS = (390, 768, 1440)
EVERY = 40  # of the pages of single names, which have one form
CUT = """return [...document.querySelectorAll("article .highlight-text:not(.columns-more) pre")]
    .filter(e => e.scrollWidth > e.clientWidth).map(e => e.textContent.slice(0, 60))"""
"""Tables of the console that do not fit, on the desk; conf.py names the widths that do."""
TALL = """return [...document.querySelectorAll(".math-block, pre")]
    .filter(e => e.scrollHeight > e.clientHeight).map(e => e.textContent.slice(0, 60))"""
"""Formulas and blocks that are cut off below, or have a scrollbar for a few pixels of height."""

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(not HTML.exists(), reason="needs the pages of .ci/docs, which runs this"),
]


def pages():
    names = sorted(HTML.glob("api/generated/*.html"))
    return sorted(set(HTML.rglob("*.html")) - set(names)) + names[::EVERY]


@pytest.fixture(scope="module")
def browser():
    with chromium(1440, 900) as driver:
        yield driver


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(HTML)))
def test_a_page_opens_without_errors_and_fits(browser, page):
    browser.get_log("browser")  # that of a page before, if its width was wrong
    browser.get(page.as_uri())
    for width in WIDTHS:
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        found = browser.execute_script("return document.documentElement.scrollWidth")
        assert found <= width, f"{found} px wide at {width} px"
        assert not browser.execute_script(TALL), f"cut off below at {width} px"
    assert not browser.execute_script(CUT)
    problems = [
        entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"
    ]
    assert not problems
