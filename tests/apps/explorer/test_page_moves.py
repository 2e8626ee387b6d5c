"""The page in headless Chromium: each move of a user, and the answers of the library to it."""

import base64
import io
import re
import time

import numpy as np
import pytest
from browser import chromium, until
from PIL import Image
from shown_page import (
    PAPER,
    begun,
    enter,
    expected_gain,
    gain_is,
    idle,
    opened,
    picture,
    reading,
    shown,
    sized,
    text_of,
    view_of,
    violations,
)

from meshtrace.apps.explorer import controls
from meshtrace.scenario import Scenario

pytestmark = [pytest.mark.browser, pytest.mark.process, pytest.mark.thorough]

FOV = "Field of view: above 0 to 180 degrees"


def test_lamp_and_receiver_move_by_keys(page):
    from selenium.webdriver.common.keys import Keys

    page.find_element("css selector", "#side [data-part=lamp]").send_keys(Keys.ARROW_DOWN)
    until(lambda: gain_is(page, {"depth": 10.5}), "another gain")


@pytest.mark.slow
def test_a_link_restores_the_state(page, url):
    enter(page, "depth", 11.5)
    page.find_element("css selector", "#lamp option[value='laser']").click()
    moves = {"depth": 11.5, "lamp": "laser"}
    until(lambda: gain_is(page, moves), "another gain", 120.0)
    place = page.execute_script("return location.hash")
    assert place == "#depth=11.5&lamp=laser"
    assert "/index.html?token=" in page.current_url  # or it could not be loaded again
    with chromium(1400, 1043) as other:
        opened(other, url + place + "&hieght=3&fov=400")
        until(lambda: gain_is(other, moves), "another state", 120.0)
        assert shown(other, "depth") == "11.5"
        told = other.find_element("id", "refused").text
        assert "hieght" in told
        assert other.find_element("id", "refused-fov").text == FOV


def test_a_card_starts_another_link(page):
    """The six of them tell their margins, and the one that is chosen has it in its results."""
    cards = page.find_elements("css selector", ".mt-starts button")
    texts = {card.get_attribute("id"): card.text for card in cards}
    assert list(texts) == [f"start-{name}" for name in controls.STARTS]
    assert all(re.search(r"(closes|fades|dead)\s[+−]\d+\.\d dB$", t) for t in texts.values())
    page.find_element("id", "start-deep").click()
    margin = texts["start-deep"].split("\n")[-1]
    shown_margin = lambda: page.find_element("id", "reading-margin").text == margin  # noqa: E731
    until(lambda: shown_margin() and reading(page) is not None, "not its margin")
    until(lambda: page.execute_script("return location.hash") == "#start=deep", "no address")
    assert page.find_element("id", "verdict").text.startswith("Dead: ")
    page.execute_script("trame.trigger('restore', [{}])")
    until(lambda: gain_is(page, {}), "the link at the start does not return")


@pytest.mark.slow
def test_two_states_stand_side_by_side(page):
    before = reading(page)
    until(lambda: idle(page), "still at work", 180.0)
    page.find_element("id", "compare").click()
    until(lambda: page.find_elements("id", "kept"), "no comparison")
    enter(page, "depth", 12.0)
    until(lambda: gain_is(page, {"depth": 12.0}), "another gain")
    assert "Depth: 10, 12 m" in page.find_element("id", "kept").text
    told = page.find_element("id", "kept-gain").text
    change = re.search(r"B − A: −(\d\.\d\d+) ± (0\.\d+) dB$", told)
    apart = 10.0 * np.log10(before / reading(page))
    assert float(change[1]) == pytest.approx(apart, abs=0.006)
    assert 0.002 < float(change[2]) < 0.05
    shot = picture(page, ".mt-scene canvas")
    left, right = np.array_split(shot[:, : shot.shape[1] // 2 * 2], 2, axis=1)
    assert (np.abs(left - right).sum(axis=2) > 30).mean() > 0.01
    page.find_element("id", "swap").click()
    until(lambda: reading(page) == before, "the first state does not return", 120.0)
    assert "Depth: 12, 10 m" in page.find_element("id", "kept").text
    page.find_element("id", "compare").click()
    until(lambda: not page.find_elements("id", "kept"), "the comparison does not end")


def test_gaps_of_the_series_are_gaps(page):
    """Gains that are left out were once bridged by a line."""
    until(lambda: idle(page), "still at work", 180.0)
    drawn = "return document.querySelector('#series .mt-line').getAttribute('d').match(/M/g).length"
    assert page.execute_script(drawn) == 1
    page.execute_script(
        "const f = trame.state.get('fading'); const kept = (v, i) => i < 20 || (i > 25 && i !== 40);"
        "trame.state.set('fading', {...f, time: f.time.filter(kept), gain: f.gain.filter(kept)})"
    )
    until(lambda: page.execute_script(drawn) == 3, "the gaps are bridged")


def test_cones_of_the_side_view_end_at_the_waves(page):
    """The rim of the beam is that of the drawn water, not that of a still sea."""
    found = page.execute_script(
        "const points = (name) => document.querySelector(`#side .mt-${name}`).getAttribute('d')"
        ".match(/-?[\\d.]+/g).map(Number); return [points('water'), points('beam'), points('view')]"
    )
    water, *cones = (np.reshape(v, (-1, 2)) for v in found)
    waves = water[1:-1]
    for cone in cones:
        rim = cone[1:]
        assert len(rim) > 5
        heights = np.interp(rim[:, 0], *waves.T)
        np.testing.assert_allclose(rim[:, 1], heights, atol=0.6)  # [px]


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
    "a": 0.15,
    "b": 0.08,
    "seed": 2.0,
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


@pytest.mark.slow
def test_the_water_changes_the_gain(page):
    page.find_element("css selector", "#water option[value='jerlov-1C']").click()
    until(lambda: gain_is(page, {"water": "jerlov-1C"}), "another gain")


@pytest.mark.slow
def test_numbers_of_the_water_follow_chlorophyll_and_wavelength(page):
    """The fields once kept a and b of the water before."""
    page.find_element("css selector", "#water option[value='chlorophyll']").click()
    until(lambda: shown(page, "a") == "0.0497", "the a of another water")
    assert (shown(page, "b"), shown(page, "chlorophyll")) == ("0.2598", "0.5")
    enter(page, "wavelength", 550)
    until(lambda: shown(page, "a") == "0.0659", "the a of another wavelength")
    enter(page, "chlorophyll", 2)
    moves = {"water": "chlorophyll", "wavelength": 550.0, "chlorophyll": 2.0}
    until(lambda: gain_is(page, moves), "another gain", 120.0)
    page.find_element("id", "python").click()
    until(lambda: "chlorophyll=2.0" in page.find_element("id", "text").text, "another program")


@pytest.mark.slow
def test_sliders_and_words_offer_what_the_link_allows(page):
    """The half angle of a laser once went to 80 deg, and types of water were refused in vain."""
    most = lambda: page.execute_script("return document.getElementById('slider-half_angle').max")  # noqa: E731
    barred = page.find_element("css selector", "#water option[value='petzold-coastal']")
    assert (most(), barred.is_enabled()) == ("80", False)
    assert barred.text == "coast (Petzold) (476.5 to 551.5 nm)"
    enter(page, "half_angle", 70)
    page.find_element("css selector", "#lamp option[value='laser']").click()
    until(lambda: (most(), shown(page, "half_angle")) == ("59.5", "59.5"), "a wider laser")
    assert page.find_elements("css selector", ".mt-refused") == []
    enter(page, "wavelength", 515)
    until(barred.is_enabled, "no water at its wavelength")


DESIGN = {
    "answer": ["By night: yes.", "By day: no. It would close at a depth of at most 7 m."],
    "tables": [{"title": "Best values", "head": ["", "given", "night", "day"],
                "rows": [["Aperture radius [cm]", "5", "20 (10 … 20), +1.5 dB", "none"]] * 12}],
    "notes": ["surfaces 64, of the scans 8"],
    "text": "ANSWER",
}  # fmt: skip


@pytest.mark.parametrize("width", [390, 768, 1440])
@pytest.mark.slow_but("390", "1440")
def test_the_page_of_a_design_fits_the_window(page, width):
    sized(page, width, 900, width == 390)
    page.execute_script("trame.state.set('design', arguments[0])", DESIGN)
    page.execute_script("trame.state.set('design_shown', true)")
    until(lambda: page.find_element("css selector", ".mt-design table").is_displayed(), "no page")
    box = "const d = document.querySelector('.mt-design');"
    size = f"{box} return [d.scrollWidth - d.clientWidth, d.scrollTop, d.getBoundingClientRect().right]"
    over, top, right = page.execute_script(size)
    assert (over, top) == (0, 0)  # it opens at the answer
    assert right <= width
    assert violations(page) == []
    page.execute_script("document.querySelector('.mt-design').dispatchEvent(new Event('close'))")
    page.find_element("id", "design-close").click()  # open: browsers tell a close before it late
    page.execute_script("trame.state.set('design', null)")


@pytest.mark.slow
def test_a_design_is_made_beside_moves_and_can_be_stopped(page):
    until(lambda: idle(page), "still at work", 180.0)
    button = page.find_element("id", "design")
    button.click()
    until(lambda: button.text.startswith("Stop"), "no work")
    enter(page, "depth", 11.0)
    until(lambda: gain_is(page, {"depth": 11.0}), "a design holds up a move", 120.0)
    assert button.text.startswith("Stop")
    button.click()
    until(lambda: button.text == "Design this link", "the work goes on")
    button.click()
    made = lambda: page.execute_script("return trame.state.get('design')")  # noqa: E731
    until(made, "no design", 400.0)
    assert made()["answer"][0].startswith("By night: ")
    assert "closes" in page.find_element("id", "design-card").text
    enter(page, "depth", 12.0)
    until(lambda: page.find_elements("css selector", "#design-card .mt-faded"), "not of then")


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

    thumb = page.find_element("id", "slider-depth")
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
    places = (
        "return [...document.querySelectorAll('.mt-number')]"
        ".map((e) => e.getBoundingClientRect().top)"
    )
    before = page.execute_script(places)
    enter(page, "fov", 400)
    until(lambda: page.find_elements("id", "refused-fov"), "no message")
    told, field = page.find_element("id", "refused-fov"), page.find_element("id", "fov")
    assert told.text == FOV
    assert field.get_attribute("aria-describedby") == "refused-fov"
    assert 0.0 <= told.rect["y"] - field.rect["y"] - field.rect["height"] < 12.0
    assert page.execute_script(places) == before
    until(lambda: shown(page, "fov") == "60", "the field keeps the refused value")
    enter(page, "wind", 80)
    until(lambda: page.find_elements("id", "refused-wind"), "not told")
    assert page.find_element("id", "refused-wind").text == "Wind: 0 to 60 m/s"
    until(lambda: shown(page, "wind") == "5", "the field keeps the refused value")
    assert gain_is(page, {})
    time.sleep(1.5)  # the page sends both controls once more: a value of that moment is lost
    enter(page, "fov", 59)
    until(lambda: not page.find_elements("css selector", ".mt-refused"), "the message stays")
    until(lambda: gain_is(page, {"fov": 59.0}), "another gain")


@pytest.mark.slow
def test_a_value_after_a_refused_one_stays(page):
    """Both are on their way before the answer to the first, which the field must not keep."""
    page.execute_script("trame.state.set('fov', 400); trame.state.flush()")
    page.execute_script("trame.state.set('fov', 50); trame.state.flush()")
    until(lambda: gain_is(page, {"fov": 50.0}), "another gain")
    time.sleep(1.0)  # the field shows 60 for a while
    until(lambda: shown(page, "fov") == "50", "the field shows another value than the state")


@pytest.mark.slow
def test_a_value_typed_while_a_refused_field_is_sent_again_stays(page):
    """All controls were once sent again: the value of another was lost."""
    page.execute_script("trame.state.set('fov', 400); trame.state.flush()")
    until(lambda: page.find_elements("id", "refused-fov"), "no message")
    page.execute_script("trame.state.set('depth', 12)")  # on its way, half a second later
    time.sleep(1.0)
    page.execute_script("trame.state.flush()")
    until(lambda: gain_is(page, {"depth": 12.0}), "another gain")


@pytest.mark.slow
def test_an_internal_error_is_a_line_of_the_page(page):
    page.execute_script("trame.trigger('seek', ['never'])")
    until(lambda: page.find_elements("id", "refused"), "no message")
    assert page.find_element("id", "refused").text.startswith("internal error: ValueError: ")
    enter(page, "fov", 59)
    until(lambda: not page.find_elements("id", "refused"), "the message stays")


@pytest.mark.slow
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
    expected = controls.State(PAPER).moved({"depth": 11.5}).scenario
    assert Scenario.from_toml(text_of(page)) == expected
    copied = "return document.querySelector('.mt-copy').innerText"
    page.execute_script("document.querySelector('.mt-copy').click()")
    until(lambda: page.execute_script(copied) == "Copied", "not copied")
    page.find_element("id", "close").click()
    page.execute_script("document.getElementById('python').click()")
    until(lambda: "mt.simulate" in text_of(page), "no program")
    assert "mt.Led(depth=11.5)" in text_of(page)


@pytest.mark.slow
def test_time_runs_and_stops(page):
    before = picture(page, ".mt-scene")
    clock = lambda: float(page.find_element("id", "time").text.split()[2])  # noqa: E731
    assert clock() == begun()
    page.find_element("id", "play").click()
    until(lambda: abs(clock() - begun()) > 1.0, "time stands still")
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


@pytest.mark.slow
def test_the_map_is_shown_in_plan_and_scene(page):
    before = picture(page, ".mt-scene")
    page.find_element("id", "map").click()
    until(lambda: page.find_elements("id", "peak"), "no map", 240.0)
    assert page.find_elements("css selector", "#plan image")
    assert re.fullmatch(r"−\d+\.\d+ dB at \(-?[\d.]+, -?[\d.]+\) m",
                        page.find_element("id", "peak").text)  # fmt: skip
    changed = lambda: (np.abs(picture(page, ".mt-scene") - before).sum(axis=2) > 30).mean()  # noqa: E731
    until(lambda: changed() > 0.002, "no map in the scene")


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
    seen = page.find_element("css selector", ".mt-scene canvas").size
    assert image.shape[1] == 2 * seen["width"]
    assert image.shape[0] > 2 * seen["height"]
    caption = image[-60:].min(axis=(1, 2))
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
def test_a_page_can_be_loaded_again_while_its_sea_runs(page):
    """Waves once arrived before the scene that holds them."""
    page.get_log("browser")
    page.find_element("id", "play").click()
    now = "return trame.state.get('time')"
    until(lambda: page.execute_script(now) != begun(), "time stands still")
    page.refresh()
    until(lambda: page.find_elements("id", "time"), "no page")
    until(lambda: page.execute_script("return trame.refs.scene.view !== null"), "no scene")
    time.sleep(1.0)
    assert [e for e in page.get_log("browser") if e["level"] == "SEVERE"] == []


@pytest.mark.slow
def test_a_move_keeps_the_view_of_the_user_and_home_returns(page):
    from selenium.webdriver.common.keys import Keys

    page.find_element("id", "home").click()
    home = view_of(page)
    canvas = page.find_element("css selector", ".mt-scene canvas")
    canvas.send_keys(Keys.ARROW_LEFT * 3 + Keys.ARROW_UP * 2 + "-")
    turned = view_of(page)
    assert turned["azimuth"] == pytest.approx(home["azimuth"] + 15.0)
    assert turned["elevation"] == pytest.approx(home["elevation"] + 6.0)
    assert turned["distance"] > home["distance"]
    enter(page, "depth", 10.4)
    until(lambda: gain_is(page, {"depth": 10.4}), "another gain")
    assert view_of(page) == turned
    page.find_element("css selector", "#light option[value='clear']").click()
    until(lambda: reading(page) is not None, "no gain by day")
    assert view_of(page) == turned
    page.find_element("id", "home").click()  # by day towards the sun, for its glint
    until(lambda: view_of(page)["azimuth"] == pytest.approx(203.0), "away from the sun")
    page.find_element("css selector", "#light option[value='none']").click()
    until(lambda: view_of(page)["azimuth"] == home["azimuth"], "another view")


@pytest.mark.slow
def test_the_sea_runs_until_the_last_browser_has_left(page):
    """Two browsers of one session: the first to leave once stopped the sea of the other."""
    clock = lambda: float(page.find_element("id", "time").text.split()[2])  # noqa: E731
    page.find_element("id", "play").click()
    until(lambda: clock() != begun(), "time stands still")
    with chromium(1400, 1043) as other:
        opened(other, page.current_url)
    time.sleep(1.0)
    left = clock()
    until(lambda: clock() not in (begun(), left), "the sea stands since the other browser has left")
    assert page.execute_script("return trame.state.get('playing')")
