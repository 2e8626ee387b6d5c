"""The page in headless Chromium, served by the command, with every other host blocked."""

import base64
import io
import json
import re
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest
from browser import chromium, until
from PIL import Image

import meshtrace as mt
from meshtrace.explorer.controls import State
from meshtrace.explorer.stages import CHAINS
from meshtrace.scenario import Scenario

pytestmark = [pytest.mark.browser, pytest.mark.process, pytest.mark.thorough]

PAPER = Scenario.from_toml("")


@pytest.fixture(scope="module")
def url():
    """Start the command and return its address."""
    command = [sys.executable, "-m", "meshtrace", "explore", "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/\S+", line)
        yield found[0]
        process.terminate()
    assert found, line


@pytest.fixture(scope="module")
def browser(url):
    with chromium(1400, 1043) as driver:
        opened(driver, url)
        yield driver


def opened(driver, url):
    driver.get(url)
    until(lambda: driver.find_elements("id", "gain"), "no page")
    until(lambda: reading(driver) is not None, "no gain", 180.0)


@pytest.fixture
def page(browser):
    """Return the browser with all controls at the paper's link."""
    for name, value in State(PAPER).values.items():
        if float(shown(browser, name) or value) != value and browser.find_elements("id", name):
            enter(browser, name, value)
    reset = {"lamp_x": 0, "lamp_y": 0, "text_shown": False, "playing": False}
    reset |= {"water": "as given", "light": "as given"}
    for name, value in reset.items():
        browser.execute_script("window.trame.state.set(arguments[0], arguments[1])", name, value)
    if browser.execute_script("return trame.state.get('time')") != 0.0:
        browser.execute_script("trame.trigger(arguments[0], [0.0])", seek_trigger(browser))
    until(lambda: gain_is(browser, {}), "the page does not return to the paper's link")
    return browser


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


def gain_is(driver, moves, time=0.0):
    """Return whether the page shows the refined gain of a state, from a run of the library."""
    expected = expected_gain(tuple(sorted(moves.items())), time)
    return reading(driver) == pytest.approx(expected, rel=1e-12)


def expected_gain(moves, time, known={}):  # noqa: B006
    if (moves, time) not in known:
        scenario = State(PAPER).moved(dict(moves)).scenario
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the page shows them as notes
            known[moves, time] = mt.simulate(scenario, photons=CHAINS[-1], time=time).gain
    return known[moves, time]


def picture(driver, selector):
    shot = driver.find_element("css selector", selector).screenshot_as_png
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


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
    assert len(asked) > 10
    assert [e for e in browser.get_log("browser") if e["level"] in ("SEVERE", "WARNING")] == []
    fonts = browser.execute_script("return [...document.fonts].filter(f => f.status == 'loaded')")
    assert len(fonts) >= 2


def test_nothing_overlaps_or_is_cut_at_1400_by_900(page):
    cut = page.execute_script(
        """
        const bad = [];
        for (const e of document.querySelectorAll('.mt-page *'))
          if (!e.closest('svg') && !e.closest('.v-btn') && e.scrollWidth > e.clientWidth + 1
              && e.clientWidth > 0 && getComputedStyle(e).display !== 'inline'
              && getComputedStyle(e).overflow !== 'visible')
            bad.push(e.className + ' ' + e.textContent.slice(0, 30));
        const cards = [...document.querySelectorAll('.mt-card, .mt-scene, .mt-views > div, .mt-head')];
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


# values of the page; all but the bit rate change the gain
MOVES = {
    "wind": 9.0,
    "fetch": 100.0,
    "depth": 14.0,
    "half_angle": 15.0,
    "height": 6.0,
    "offset_x": 1.0,
    "offset_y": -1.5,
    "tilt": 10.0,
    "fov": 40.0,
    "aperture": 8.0,
}


@pytest.mark.slow
def test_each_control_changes_the_gain_as_the_library_does(page):
    """Entered one after the other: each on top of those before."""
    moves, readings = {}, [reading(page)]
    for name, value in MOVES.items():
        moves[name] = value
        enter(page, name, value)
        until(lambda: gain_is(page, moves), f"another gain by {name}", 120.0)
        readings.append(reading(page))
        assert float(shown(page, name)) == value
    assert len(set(readings)) == 1 + len(MOVES)


def test_the_water_changes_the_gain(page):
    page.find_element("css selector", "#water option[value='jerlov-1C']").click()
    until(lambda: gain_is(page, {"water": "jerlov-1C"}), "another gain")


@pytest.mark.slow
def test_the_bit_rate_changes_bits_and_not_the_gain(page):
    rate = page.find_element("id", "reading-required").text
    enter(page, "bit_rate", 20)
    changed = lambda: page.find_element("id", "reading-required").text not in (rate, "–")  # noqa: E731
    until(changed, "the required power stays")
    until(lambda: gain_is(page, {}), "the gain changes")


@pytest.mark.slow
def test_daylight_adds_background_and_keeps_the_gain(page):
    page.find_element("css selector", "#light option[value='clear']").click()
    counts = lambda: page.find_element("id", "reading-background").text  # noqa: E731
    until(lambda: re.fullmatch(r"\d[\d.e+]* counts/s", counts()), "no background", 120.0)
    until(lambda: gain_is(page, {}), "the gain changes")


def test_a_slider_moves_its_value(page):
    from selenium.webdriver.common.keys import Keys

    thumb = page.find_element("css selector", ".mt-control:has(#depth) .v-slider-thumb")
    thumb.send_keys(Keys.ARROW_RIGHT)
    until(lambda: float(shown(page, "depth")) == 10.5, "the slider does not move the field")
    until(lambda: gain_is(page, {"depth": 10.5}), "another gain")


def drag(driver, view, part, x, y):
    """Drag a part of a view by pixels, in steps as a hand does."""
    from selenium.webdriver import ActionChains

    handle = driver.find_element("css selector", f"#{view} [data-part={part}] .mt-grip")
    chain = ActionChains(driver, duration=30).move_to_element(handle).click_and_hold()
    for _ in range(8):
        chain.move_by_offset(x // 8, y // 8)
    chain.release().perform()


@pytest.mark.parametrize(
    ("view", "part", "names"),
    [
        ("side", "lamp", ("lamp_x", "depth")),
        ("side", "receiver", ("offset_x", "height")),
        ("plan", "receiver", ("offset_x", "offset_y")),
        ("plan", "lamp", ("lamp_x", "lamp_y")),
    ],
)
@pytest.mark.slow_but("side-lamp-names0")
def test_dragging_writes_the_same_state(page, view, part, names):
    """In the plan lamp and receiver lie on each other at first."""
    moves = {}
    if view == "plan":
        enter(page, "offset_x", -3.0)
        until(lambda: gain_is(page, {"offset_x": -3.0}), "another gain")
        moves["offset_x"] = -3.0
    before = {name: page.execute_script(f"return trame.state.get('{name}')") for name in names}
    drag(page, view, part, 40, -24)
    moved = {name: page.execute_script(f"return trame.state.get('{name}')") for name in names}
    sign = -1.0 if names[1] == "depth" else 1.0
    assert moved[names[0]] > before[names[0]] + 0.5
    assert sign * moved[names[1]] > sign * before[names[1]] + 0.5
    until(lambda: gain_is(page, {**moves, **moved}), "another gain", 120.0)


def test_a_refused_value_says_so_and_the_state_stays(page):
    enter(page, "fov", 400)
    until(lambda: page.find_elements("id", "refused"), "no message")
    assert "fov_deg: 400" in page.find_element("id", "refused").text
    until(lambda: shown(page, "fov") == "60", "the field keeps the refused value")
    enter(page, "wind", 80)
    until(lambda: "wind_speed: 80" in page.find_element("id", "refused").text, "not told")
    until(lambda: shown(page, "wind") == "5", "the field keeps the refused value")
    assert gain_is(page, {})
    enter(page, "fov", 59)
    until(lambda: not page.find_elements("id", "refused"), "the message stays")
    until(lambda: gain_is(page, {"fov": 59.0}), "another gain")


def test_a_value_after_a_refused_one_stays(page):
    """Both are on their way before the answer to the first, which the field must not keep."""
    page.execute_script("trame.state.set('fov', 400); trame.state.flush()")
    page.execute_script("trame.state.set('fov', 50); trame.state.flush()")
    until(lambda: gain_is(page, {"fov": 50.0}), "another gain")
    time.sleep(1.0)  # the field shows 60 for a while
    until(lambda: shown(page, "fov") == "50", "the field shows another value than the state")


def test_an_internal_error_is_a_line_of_the_page(page):
    page.execute_script("trame.trigger(arguments[0], ['never'])", seek_trigger(page))
    until(lambda: page.find_elements("id", "refused"), "no message")
    assert page.find_element("id", "refused").text.startswith("internal error: ValueError: ")
    enter(page, "fov", 59)
    until(lambda: not page.find_elements("id", "refused"), "the message stays")


def test_a_link_that_cannot_be_traced_says_why(page):
    enter(page, "height", 0.01)
    until(lambda: page.find_elements("id", "notes"), "no message")
    assert "highest crest" in page.find_element("id", "notes").text


@pytest.mark.slow
def test_the_copied_texts_describe_the_link(page):
    enter(page, "depth", 11.5)
    until(lambda: gain_is(page, {"depth": 11.5}), "another gain")
    page.find_element("id", "toml").click()
    until(lambda: "depth" in text_of(page), "no text")
    expected = State(PAPER).moved({"depth": 11.5}).scenario
    assert Scenario.from_toml(text_of(page)) == expected
    copied = "return document.querySelector('.mt-copy').innerText"
    page.execute_script("document.querySelector('.mt-copy').click()")
    until(lambda: page.execute_script(copied) == "Copied", "not copied")
    page.find_element("id", "close").click()
    page.execute_script("document.getElementById('python').click()")
    until(lambda: "mt.simulate" in text_of(page), "no program")
    assert "mt.Led(depth=11.5)" in text_of(page)


def text_of(driver):
    """Return the text in the dialog."""
    read = "return document.getElementById('text')?.textContent ?? ''"
    return driver.execute_script(read)


@pytest.mark.slow
def test_time_runs_and_stops(page):
    before = picture(page, ".mt-scene")
    clock = lambda: float(page.find_element("id", "time").text.split()[2])  # noqa: E731
    assert clock() == 0.0
    page.find_element("id", "play").click()
    until(lambda: clock() > 1.0, "time stands still")
    assert (np.abs(picture(page, ".mt-scene") - before).sum(axis=2) > 30).mean() > 0.01
    page.find_element("id", "play").click()

    def stands():
        stopped = clock()
        time.sleep(0.5)
        return clock() == stopped

    until(stands, "time goes on after a pause")  # the server may hear of it late
    until(lambda: reading(page) is not None and idle(page), "no gain after a pause", 120.0)
    sample = page.execute_script("return trame.state.get('time')")
    wanted = pytest.approx(expected_gain((), sample), rel=0.05)
    until(lambda: reading(page) == wanted, "not the gain at that time", 120.0)


def seek_trigger(driver):
    """Return the name of the action behind the chart."""
    markup = driver.execute_script("return trame.state.get('trame__template_main')")
    return re.search(r"@seek=\"trigger\('([^']+)'", markup)[1]


@pytest.mark.slow
def test_the_map_is_shown_in_plan_and_scene(page):
    before = picture(page, ".mt-scene")
    page.find_element("id", "map").click()
    until(lambda: page.find_elements("id", "peak"), "no map", 240.0)
    assert page.find_elements("css selector", "#plan image")
    assert re.fullmatch(r"[\d.e-]+ at \(-?[\d.]+, -?[\d.]+\) m",
                        page.find_element("id", "peak").text)  # fmt: skip
    assert (np.abs(picture(page, ".mt-scene") - before).sum(axis=2) > 30).mean() > 0.002


@pytest.mark.slow
def test_the_saved_picture_shows_scene_and_caption(page):
    page.execute_script(
        "window.saved = []; HTMLAnchorElement.prototype.click = function () {"
        "window.saved.push([this.download, this.href]) }"
    )
    page.find_element("id", "picture").click()
    until(lambda: page.execute_script("return window.saved.length"), "no picture")
    name, data = page.execute_script("return window.saved[0]")
    image = np.asarray(Image.open(io.BytesIO(base64.b64decode(data.split(",")[1]))).convert("RGB"))
    assert name == "meshtrace.png"
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 500
    caption = image[-15:].min(axis=(1, 2))
    assert (caption < 100).any()


@pytest.mark.slow
def test_two_browsers_have_two_states(page, url):
    with chromium(1400, 1043) as other:
        opened(other, url)
        enter(other, "depth", 17.0)
        enter(page, "height", 7.0)
        until(lambda: gain_is(other, {"depth": 17.0}), "another gain", 120.0)
        until(lambda: gain_is(page, {"height": 7.0}), "another gain", 120.0)
        assert (shown(page, "depth"), shown(other, "height")) == ("10", "5")


@pytest.mark.slow
def test_a_page_can_be_loaded_again_with_its_state(page):
    enter(page, "depth", 13.0)
    until(lambda: gain_is(page, {"depth": 13.0}) and idle(page), "another gain")
    seen = picture(page, ".mt-scene canvas")
    page.refresh()
    until(lambda: page.find_elements("id", "depth"), "no page")
    until(lambda: gain_is(page, {"depth": 13.0}), "another state after loading again")
    same = lambda: np.abs(picture(page, ".mt-scene canvas") - seen).mean() < 1.0  # noqa: E731
    until(same, "another scene after loading again")


@pytest.mark.slow
def test_a_move_keeps_the_camera_of_the_user(page):
    camera = lambda: page.execute_script("return trame.refs.scene.getCamera()")  # noqa: E731
    turned = camera() | {"position": [-30.0, -50.0, 15.0]}
    page.execute_script("trame.refs.scene.setCamera(arguments[0])", turned)
    enter(page, "depth", 10.4)
    until(lambda: gain_is(page, {"depth": 10.4}) and idle(page), "another gain")
    assert camera()["position"] == pytest.approx([-30.0, -50.0, 15.0])


@pytest.mark.slow
def test_the_sea_runs_until_the_last_browser_has_left(page):
    """Two browsers of one session: the first to leave once stopped the sea of the other."""
    clock = lambda: float(page.find_element("id", "time").text.split()[2])  # noqa: E731
    page.find_element("id", "play").click()
    until(lambda: clock() > 0.3, "time stands still")
    with chromium(1400, 1043) as other:
        opened(other, page.current_url)
    time.sleep(1.0)
    left = clock()
    until(lambda: clock() not in (0.0, left), "the sea stands since the other browser has left")
    assert page.execute_script("return trame.state.get('playing')")
