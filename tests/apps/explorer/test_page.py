"""The page in headless Chromium: what it loads, how it looks, and who can read it."""

import json

import numpy as np
import pytest
from browser import until
from shown_page import enter, gain_is, idle, luminance, picture, sized, violations

from meshtrace.viz import live

pytestmark = [pytest.mark.browser, pytest.mark.process, pytest.mark.thorough]


def test_the_page_asks_no_other_host_and_logs_no_error(browser, url):
    until(lambda: idle(browser), "still at work", 180.0)
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = {
        m["params"]["request"]["url"]
        for m in messages
        if m["method"] == "Network.requestWillBeSent"
    }
    others = {a for a in asked if not a.startswith(("http://127.0.0.1:", "data:", "blob:"))}
    assert others == set()
    assert len(asked) > 8
    assert [e for e in browser.get_log("browser") if e["level"] in ("SEVERE", "WARNING")] == []
    files = [m["params"] for m in messages if m["method"] == "Network.loadingFinished"]
    frames = [m["params"]["response"] for m in messages
              if m["method"] == "Network.webSocketFrameReceived"]  # fmt: skip
    received = sum(f["encodedDataLength"] for f in files)
    received += sum(0.75 * len(f["payloadData"]) for f in frames)  # base64
    assert 0.5e6 < received < 4e6


def test_scripts_load_in_any_order(page):
    """The scene was once missing where its shaders arrived after it."""
    text = (live.ASSETS / "scene.js").read_text("utf-8")
    page.execute_script(
        "const { meshtraceShaders, meshtraceScene } = window; window.meshtraceShaders = undefined;"
        "try { (0, eval)(arguments[0]); } finally { Object.assign(window, "
        "{ meshtraceShaders, meshtraceScene }); }",
        text,
    )


def test_messages_are_read_in_order(page):
    """Rays were once replaced by the empty ones of the large message with the sea before them."""
    order = page.execute_async_script(
        """const done = arguments[0], order = [], read = async (n, bytes) => {
             const message = new Blob([new Uint8Array(bytes)]);
             await message.slice(0, 12).arrayBuffer();
             await message.slice(12).arrayBuffer();
             order.push(n);
           };
           Promise.all(Array.from({ length: 40 }, (_, n) => read(n, n % 2 ? 300 : 1e6)))
             .then(() => done(order));"""
    )
    assert order == list(range(40))


def test_nothing_overlaps_or_is_cut_at_1400_by_900(page):
    cut = page.execute_script(
        """
        const bad = [];
        for (const e of document.querySelectorAll('.mt-page *'))
          if (!e.closest('svg, button, input') && e.scrollWidth > e.clientWidth + 1
              && e.clientWidth > 0 && getComputedStyle(e).display !== 'inline'
              && getComputedStyle(e).overflow !== 'visible')
            bad.push(e.className + ' ' + e.textContent.slice(0, 30));
        const cards = [...document.querySelectorAll('.mt-left, .mt-right, .mt-scene, .mt-views > div, .mt-head')];
        const boxes = cards.map((c) => c.getBoundingClientRect());
        boxes.forEach((a, i) => boxes.slice(i + 1).forEach((b, j) => {
          if (a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1)
            bad.push(`${cards[i].className} and ${cards[i + 1 + j].className}`);
        }));
        boxes.forEach((a, i) => {
          if (a.right > innerWidth || a.bottom > innerHeight) bad.push(`${cards[i].className} outside`);
        });
        return bad;
        """
    )
    assert page.execute_script("return [innerWidth, innerHeight]") == [1400, 900]
    assert cut == []


@pytest.mark.parametrize(("width", "columns"), [(390, 1), (768, 1), (1440, 3)])
def test_a_narrow_window_has_one_column_with_the_scene_on_top(page, width, columns):
    sized(page, width, 900)
    until(lambda: page.execute_script("return innerWidth") == width, "another width")
    boxes = page.execute_script(
        "return ['scene', 'left', 'views', 'right'].map((n) => {"
        "const b = document.querySelector(`.mt-${n}`).getBoundingClientRect();"
        "return [b.left, b.top + scrollY, b.right]})"
    )
    assert page.execute_script("return document.documentElement.scrollWidth") <= width
    assert len({round(left) for left, *_ in boxes}) == columns
    assert all(0.0 <= left < right <= width for left, _, right in boxes)
    if columns == 1:
        tops = [top for _, top, _ in boxes]
        assert tops[0] == min(tops)
        page.execute_script("scrollTo(0, 1200)")
        seen = "return document.querySelector('.mt-scene').getBoundingClientRect().top"
        until(lambda: page.execute_script(seen) == 0, "the scene scrolls away")
        page.execute_script("scrollTo(0, 0)")


def test_a_phone_held_across_has_no_bar_below(page):
    sized(page, 844, 390)
    until(lambda: page.execute_script("return innerWidth") == 844, "another width")
    assert page.execute_script("return document.documentElement.scrollWidth") <= 844


def test_few_stops_lead_to_the_side_view(page):
    """There were once 60, and no link past them."""
    stops = page.execute_script(
        "return [...document.querySelectorAll('a[href],button,input,select,summary,[tabindex]')]"
        ".filter((e) => e.tabIndex >= 0 && !e.disabled && !e.closest('dialog'))"
        ".findIndex((e) => e.closest('#side'))"
    )
    assert 0 < stops <= 25
    for name in ("views", "controls", "results"):
        page.find_element("css selector", f".mt-skip a[href='#{name}']").send_keys("\n")
        assert page.switch_to.active_element.get_attribute("id") == name
    assert page.execute_script("return location.hash") == ""


def test_nothing_moves_by_itself_where_that_is_asked(page):
    features = [{"name": "prefers-reduced-motion", "value": "reduce"}]
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    moving = (
        "return [...document.querySelectorAll('.mt-page *')].map((e) => getComputedStyle(e))"
        ".filter((s) => s.animationName !== 'none' || s.transitionDuration !== '0s').length"
    )
    assert page.execute_script(moving) == 0


def test_it_prints_in_ink_without_buttons(page):
    """White words on backgrounds that printers leave out were once unreadable."""
    sized(page, 760, 1080, dark=True)
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    shown_buttons, inks = page.execute_script(
        "return [[...document.querySelectorAll('.mt-page button')].filter((e) => e.checkVisibility())"
        ".length, ['h1', '#gain', '#verdict', 'dt', '.mt-card h2'].map((s) =>"
        "getComputedStyle(document.querySelector(s)).color)]"
    )
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert shown_buttons == 0
    assert all(1.05 / (luminance(ink) + 0.05) >= 7.0 for ink in inks)


def test_the_page_can_be_enlarged(page):
    content = page.find_element("css selector", "meta[name=viewport]").get_attribute("content")
    assert "width=device-width" in content
    assert "maximum-scale" not in content
    assert "user-scalable" not in content


@pytest.mark.parametrize("dark", [False, True])
def test_the_colours_follow_the_system_and_texts_stand_out(page, dark):
    sized(page, 1400, 900, dark)
    pairs = page.execute_script(
        "return ['dt', '.mt-note', '.mt-control label', '.mt-card h2', '#gain', '#map']"
        ".map((s) => document.querySelector(s)).filter(Boolean).map((e) => ["
        "getComputedStyle(e).color, getComputedStyle(e.closest('.mt-card')).backgroundColor])"
    )
    for ink, card in pairs:
        low, high = sorted((luminance(ink), luminance(card)))
        assert (luminance(card) < luminance(ink)) == dark
        assert (high + 0.05) / (low + 0.05) >= 4.5


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1440])
@pytest.mark.slow_but("1440-False")
def test_axe_finds_no_violation(page, width, dark):
    sized(page, width, 900, dark)
    assert violations(page) == []


def test_every_control_has_a_label_and_takes_the_focus(page):
    names = page.execute_script(
        "return [...document.querySelectorAll('button, input, select, canvas, [role=slider]')]"
        ".filter((e) => !e.closest('dialog')).map((e) => [e.id || e.outerHTML.slice(0, 60),"
        "(e.getAttribute('aria-label') || e.labels?.[0]?.textContent || e.textContent).trim(),"
        "e.disabled || (e.focus(), document.activeElement === e)])"
    )
    assert len(names) > 60
    assert [name for name, label, _ in names if len(label) < 2] == []
    assert [name for name, _, focus in names if not focus] == []


def test_the_ruler_reads_the_depth_of_the_lamp(browser):
    """In perspective a ruler at another distance than the lamp read 13 to 21 % wrong."""
    sized(browser, 1400, 1000)
    marks, at, lamp = browser.execute_script(
        "const scene = trame.refs.scene, lamp = scene.painter.models.now.link.lamps[0].at;"
        "return [scene.ruler, scene.onScreen(lamp), [...lamp]]"
    )
    heights = {mark["z"]: mark["at"][1] for mark in marks}
    assert lamp[2] == -10.0
    assert heights[-10] == pytest.approx(at[1], abs=1.0)
    assert all(mark["at"][0] <= at[0] for mark in marks)


def test_labels_of_the_ruler_do_not_overlap_on_a_phone(page):
    sized(page, 390, 844, True)
    for name, value in (("depth", 4.0), ("height", 7.0)):
        enter(page, name, value)
    until(lambda: gain_is(page, {"depth": 4.0, "height": 7.0}), "another gain")
    page.find_element("id", "home").click()
    top = "return [...document.querySelectorAll('#pole ~ g > text')]"
    top += ".filter((t) => /^(0|−)/.test(t.textContent))"
    top += ".map((t) => t.getBoundingClientRect()).map((box) => [box.top, box.bottom])"
    boxes = np.array(page.execute_script(top))
    assert len(boxes) >= 2
    assert (boxes[1:, 0] - boxes[:-1, 1]).min() > -1.0  # of lines of text, with their room


@pytest.mark.parametrize("place", [{"height": 40.0}, {"height": 2.0, "depth": 1.0}])
@pytest.mark.slow_but("place0")
def test_the_lamp_is_seen_at_any_place(page, place):
    """High receivers and shallow lamps once hid it behind the opaque sea."""
    for name, value in place.items():
        enter(page, name, value)
    until(lambda: gain_is(page, place), "another gain")
    page.find_element("id", "home").click()
    sharp = "const c = document.querySelector('.mt-scene canvas'); return c.width === c.clientWidth"
    until(lambda: page.execute_script(sharp), "a coarse scene")
    x, y = page.execute_script(
        "const s = trame.refs.scene; return s.onScreen(s.painter.models.now.link.lamps[0].at)"
    )
    shot = picture(page, ".mt-scene canvas").sum(axis=2)
    row, column = round(y), round(x)
    around = shot[row - 40 : row + 41, column - 40 : column + 41]
    assert shot[row - 2 : row + 3, column - 2 : column + 3].mean() > 1.4 * np.median(around)


@pytest.mark.slow
def test_storm_and_calm_look_different(page):
    """Foam and longer waves: 3 and 15 m/s were once told apart by the number alone."""
    shots = {}
    for wind in (3.0, 15.0):
        enter(page, "wind", wind)
        until(lambda: gain_is(page, {"wind": wind}), "another gain")  # noqa: B023
        shots[wind] = picture(page, ".mt-scene canvas").sum(axis=2)
    different = np.abs(shots[3.0] - shots[15.0]) > 60
    assert different.mean() > 0.1
    lit = [(shot[: shot.shape[0] // 2] > 330).mean() for shot in shots.values()]
    assert lit[1] > 1.2 * lit[0]
