"""The built pages in headless Chromium at the widths of a phone, a tablet and a desk."""

from pathlib import Path

import pytest
from browser import chromium, until

HTML = Path(__file__).parents[2] / "docs" / "_build" / "html"
WIDTHS = (390, 768, 1440)
EVERY = 40  # of the pages of single names, which have one form
CUT = """return [...document.querySelectorAll("article .highlight-text:not(.columns-more) pre")]
    .filter(e => e.scrollWidth > e.clientWidth).map(e => e.textContent.slice(0, 60))"""
"""Tables of the console that do not fit, on the desk; conf.py names the widths that do."""
TALL = """return [...document.querySelectorAll(".math-block, pre")]
    .filter(e => e.scrollHeight > e.clientHeight).map(e => e.textContent.slice(0, 60))"""
"""Formulas and blocks that are cut off below, or have a scrollbar for a few pixels of height."""

SILENT = """return [...document.querySelectorAll("article img:not(.sphx-glr-thumbcontainer img)")]
    .filter(e => !e.alt.trim()).map(e => e.src)"""
"""Pictures without words, but thumbnails, whose links have them."""
LOWEST = """return Math.max(...[...document.querySelectorAll("h1, h1 + p, .buttons a")]
    .map(e => e.getBoundingClientRect().bottom))"""
"""Lower edge of headline, first sentence and buttons of the landing page."""

TITLES = """return [...document.querySelectorAll(".sphx-glr-thumbcontainer")].map(e => {
    const words = document.createRange();
    words.selectNodeContents(e.querySelector(".sphx-glr-thumbnail-title"));
    return words.getBoundingClientRect().left - e.getBoundingClientRect().left })"""
"""Indents of the words below the thumbnails of the gallery [pixel]."""
PAGES = (
    "index.html",
    "examples/index.html",
    "guides/design.html",
    "api/generated/meshtrace.simulate.html",
)
"""One page of each form."""

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


def see(browser, width, scheme="light"):
    """Show a page on a screen of a width, in a light or dark scheme."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    wanted = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": wanted})


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(HTML)))
def test_a_page_opens_without_errors_and_fits(browser, page):
    browser.get_log("browser")  # that of a page before, if its width was wrong
    browser.get(page.as_uri())
    for width in WIDTHS:
        see(browser, width)
        found = browser.execute_script("return document.documentElement.scrollWidth")
        assert found <= width, f"{found} px wide at {width} px"
        assert not browser.execute_script(TALL), f"cut off below at {width} px"
    assert not browser.execute_script(CUT)
    assert not browser.execute_script(SILENT)
    first = browser.execute_script("return document.querySelector('body a').className")
    assert "skip" in first or page.parent.name == "figures"
    problems = [
        entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"
    ]
    assert not problems


def test_the_landing_page_says_what_it_is_above_the_fold(browser):
    browser.get((HTML / "index.html").as_uri())
    for width, height in ((1440, 900), (390, 844)):
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        assert browser.execute_script(LOWEST) < height
    assert browser.execute_script("return document.querySelectorAll('.buttons a').length") == 3


def test_guides_come_before_single_names(browser):
    browser.get(f"{(HTML / 'search.html').as_uri()}?q=lidar")
    found = (
        "return [...document.querySelectorAll('ul.search li a')].map(e => e.getAttribute('href'))"
    )
    links = until(lambda: browser.execute_script(found), "no page was found")
    assert "api/" not in links[0]


def test_the_titles_of_the_gallery_begin_at_one_edge(browser):
    browser.get((HTML / "examples" / "index.html").as_uri())
    for width in WIDTHS:
        see(browser, width)
        places = browser.execute_script(TITLES)
        assert len(places) > 10
        assert max(places) - min(places) < 1.0, f"titles are indented unevenly at {width} px"


@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (1440, "dark")])
@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_accessible(browser, page, width, scheme):
    axe = pytest.importorskip("axe_core_python.selenium").Axe()
    see(browser, width, scheme)
    browser.get((HTML / page).as_uri())
    found = axe.run(browser)["violations"]
    assert not [(v["id"], v["nodes"][0]["html"]) for v in found]
