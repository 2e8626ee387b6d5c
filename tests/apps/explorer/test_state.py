"""The state: each control moves the value that it names, and both texts describe the same link."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

import meshtrace as mt
from meshtrace.apps.explorer import controls, readings, scenario_of
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario

# control, value in the units of the page, what the scenario then holds
EFFECTS = {
    "wind": (8.0, lambda s: s.wind_speed == s.surface.wind_speed == s.link.wind_speed == 8.0),
    "fetch": (50.0, lambda s: s.surface.fetch == 50e3),
    "depth": (12.5, lambda s: s.link.transmitter.depth == 12.5),
    "lamp_x": (-1.5, lambda s: s.link.transmitter.position == (-1.5, 0.0)),
    "lamp_y": (0.7, lambda s: s.link.transmitter.position == (0.0, 0.7)),
    "half_angle": (20.0, lambda s: s.link.transmitter.half_angle_deg == 20.0),
    "height": (8.0, lambda s: s.link.receiver.height == 8.0),
    "offset_x": (2.0, lambda s: s.link.receiver.position == (2.0, 0.0)),
    "offset_y": (-2.0, lambda s: s.link.receiver.position == (0.0, -2.0)),
    "tilt": (15.0, lambda s: s.link.receiver.tilt_deg == 15.0),
    "fov": (30.0, lambda s: s.link.receiver.fov_deg == 30.0),
    "aperture": (2.5, lambda s: s.link.receiver.radius == 0.025),
    "bit_rate": (5.0, lambda s: s.detector.bit_rate == 5e6),
    "seed": (3.0, lambda s: s.surface.seed == 3),
    "a": (0.2, lambda s: s.link.water.a == 0.2),
    "b": (0.4, lambda s: s.link.water.b == 0.4),
    "power": (500.0, lambda s: s.link.transmitter.power_mw == 500.0),
    "wavelength": (514.0, lambda s: s.link.transmitter.wavelength_nm == 514.0),
    "filter": (2.0, lambda s: s.detector.optics.filter_width_nm == 2.0),
    "pde": (40.0, lambda s: s.detector.sipm.pde == 0.4),
}
LIT = Scenario.from_toml('[daylight]\nmodel = "clear"')
PAPER = Scenario.from_toml("")
GREEN = Scenario.from_toml("[transmitter]\nwavelength_nm = 514.0")
"""A link at the wavelength of all types of water."""


def test_every_control_has_an_effect_to_test():
    assert {*EFFECTS, "sun", "chlorophyll"} == set(controls.BY_NAME)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_control_moves_its_value_and_no_other(name):
    value, effect = EFFECTS[name]
    state = controls.State(PAPER)
    moved = state.moved({name: value})
    assert effect(moved.scenario)
    if name in ("bit_rate", "filter", "pde"):
        assert state.scenario.detector is None
    else:
        assert not effect(state.scenario)
    assert moved.values == {**state.values, name: value}


def test_the_sun_moves_where_there_is_one():
    moved = controls.State(LIT).moved({"sun": 60.0}).scenario.daylight
    assert (moved.sun_zenith_deg, LIT.daylight.sun_zenith_deg) == (60.0, 30.0)
    assert controls.State(PAPER).moved({"light": "clear", "sun": 60.0}).scenario.daylight == moved
    with pytest.raises(Refused, match="sun"):
        controls.State(PAPER).moved({"sun": 60.0})


def test_numbers_replace_those_of_a_chosen_type():
    """A type of water gives both coefficients, at the wavelength of the lamp."""
    moves = {"water": "jerlov-II", "wavelength": 520.0}
    typed = controls.State(PAPER).moved(moves)
    expected = mt.Water.from_type("jerlov-II", 520.0)
    assert typed.scenario.link.water == expected
    water = typed.moved({"a": 0.3}).scenario.link.water
    assert (water.a, water.b) == (0.3, expected.b)


def test_water_by_chlorophyll_follows_the_wavelength():
    """Its a and b once had to be typed for each wavelength."""
    state = controls.State(PAPER).moved({"water": controls.CASE_1, "chlorophyll": 2.0})
    spectrum = mt.optics.Constituents(chlorophyll=2.0)
    for nm in (470.0, 550.0):
        state = state.moved({"wavelength": nm})
        expected = mt.Water(spectrum=spectrum, wavelength_nm=nm)
        assert state.scenario.link.water == expected
        assert state.values["a"] == pytest.approx(expected.a, rel=5e-3)
        assert state.values["b"] == pytest.approx(expected.b, rel=5e-3)
    typed = state.moved({"a": 0.3})
    assert (typed.scenario.link.water.a, typed.scenario.link.water.b) == (0.3, expected.b)
    assert typed.values["chlorophyll"] == 2.0
    assert typed.moved({"chlorophyll": 2.5}).scenario.link.water.spectrum.chlorophyll == 2.5
    with pytest.raises(Refused, match="chlorophyll"):
        controls.State(PAPER).moved({"chlorophyll": 2.0})


def test_a_profile_of_chlorophyll_is_no_control():
    given = Scenario.from_toml("[water]\nchlorophyll = [[0, 0.2], [20, 1]]")
    assert controls.State(given).values["chlorophyll"] is None


def test_another_water_ends_moves_of_its_numbers():
    """A type of water once kept the a that was moved before it was chosen."""
    moved = controls.State(PAPER).moved({"a": 0.3, "depth": 12.0}).moved({"water": "jerlov-II"})
    assert moved.scenario.link.water == mt.Water.from_type("jerlov-II", 470.0)
    assert moved.values["depth"] == 12.0
    lit = controls.State(PAPER).moved({"light": "clear"}).moved({"sun": 60.0})
    assert lit.moved({"light": "none"}).moves == ()
    assert lit.moved({"light": "overcast"}).values["sun"] == 60.0
    typed = moved.moved({"a": 0.114})  # the number of the link as given
    assert typed.scenario.link.water.a == 0.114


@pytest.mark.parametrize("link", [mt.Link(), mt.Link().mirrored()], ids=["up", "down"])
def test_a_wide_lamp_becomes_the_widest_laser(link):
    """The laser was once refused beside an LED of 70 deg, and its slider went to 80 deg."""
    wide = controls.State(scenario_of(link)).moved({"half_angle": 70.0})
    laser = wide.moved({"lamp": "laser"})
    assert laser.scenario.link.transmitter.divergence_deg == 59.5
    assert (wide.ranges["half_angle"], laser.ranges["half_angle"]) == ((0.5, 80.0), (0.5, 59.5))
    assert controls.State(wide.scenario).moved({"lamp": "laser"}).values["half_angle"] == 59.5
    top_hat = laser.moved({"lamp": "top hat"}).moved({"half_angle": 75.0})
    assert top_hat.scenario.link.transmitter.divergence_deg == 75.0


def test_the_wavelength_stays_within_the_tables_of_the_water():
    state = controls.State(GREEN).moved({"water": "petzold-harbour"})
    assert state.ranges["wavelength"] == (480.0, 550.0)
    assert controls.State(PAPER).ranges["wavelength"] == (400.0, 700.0)
    assert controls.State(PAPER).barred["petzold-harbour"] == "476.5 to 551.5 nm"
    assert controls.State(GREEN).barred == {}


def ends(state):
    """Return the controls that the page offers in a state, each with the ends of its slider."""
    return [(n, end) for n, pair in state.ranges.items() if state.values[n] is not None
            for end in pair]  # fmt: skip


WORDS = [(name, word) for name, choice in controls.CHOICES.items() for word in choice.words]
LIKE_I = [f"jerlov-{name}" for name in ("IA", "IB", "II", "III", "1C", "7C")]
"""Types of water with the wavelengths of jerlov-I, more turbid than it and clearer than 9C."""


@pytest.mark.slow
@pytest.mark.parametrize("left_out", [LIKE_I, []], ids=len)
def test_no_pair_of_a_choice_and_the_end_of_a_slider_is_refused(left_out):
    """Neither one after the other: what the page offers, it accepts."""
    start, tried = controls.State(PAPER), 0
    words = [(name, word) for name, word in WORDS if word not in left_out]
    for word in left_out:
        clearest, other = (start.moved({"water": water}) for water in ("jerlov-I", word))
        assert (other.ranges, other.barred) == (clearest.ranges, clearest.barred)
    for name, word in words:
        if word in start.barred:
            continue
        chosen = start.moved({name: word})
        for control, value in ends(chosen):
            chosen.moved({control: value})
            tried += 1
        for other, second in words:
            if other != name and second not in chosen.barred:
                chosen.moved({other: second})
    for control, value in ends(start):
        moved = start.moved({control: value})
        for name, word in words:
            if word not in moved.barred:
                moved.moved({name: word})
                tried += 1
    assert tried > 60 * len(words)


@pytest.mark.parametrize(
    ("word", "kind"), [("laser", "gaussian-beam"), ("top hat", "top-hat-beam")]
)
@pytest.mark.parametrize("link", [mt.Link(), mt.Link().mirrored()], ids=["up", "down"])
def test_another_kind_of_lamp_keeps_place_and_angle(word, kind, link):
    state = controls.State(scenario_of(link)).moved({"power": 50.0, "half_angle": 4.0})
    old, new = (s.scenario.link.transmitter for s in (state, state.moved({"lamp": word})))
    assert (new.pattern, new.divergence_deg, new.power_mw) == (kind, 4.0, 50.0)
    assert (new.center, new.axis) == (old.center, old.axis)
    back = controls.State(state.moved({"lamp": word}).scenario).moved({"lamp": "LED"})
    assert back.scenario.link.transmitter == old


def test_detector_and_aircraft_are_those_of_a_link_file():
    moved = controls.State(PAPER).moved(
        {"detector": "paper", "aircraft": "dji-m300-rtk-no-payload"}
    )
    text = '[detector]\npreset = "paper"\n[uav]\npreset = "dji-m300-rtk-no-payload"'
    expected = Scenario.from_toml(text)
    assert (moved.scenario.detector, moved.scenario.uav) == (expected.detector, expected.uav)
    assert moved.channel.link == PAPER.link


@pytest.mark.parametrize("water", controls.CHOICES["water"].words)
def test_the_water_is_that_of_the_type(water):
    state = controls.State(GREEN).moved({"water": water})
    if water == controls.CASE_1:
        spectrum = mt.optics.Constituents(chlorophyll=0.5)
        expected = mt.Water(spectrum=spectrum, wavelength_nm=514.0)
    else:
        expected = mt.Water.from_type(water, 514.0)
    assert state.scenario.link.water == expected
    assert state.settings["water"] == water


@pytest.mark.parametrize("light", controls.CHOICES["light"].words)
def test_the_light_is_that_of_the_link_file(light):
    state = controls.State(PAPER).moved({"light": light})
    expected = Scenario.from_toml(f'[daylight]\nmodel = "{light}"')
    assert state.scenario.daylight == expected.daylight
    assert state.channel == PAPER


def test_links_downwards_move_as_well():
    down = scenario_of(mt.Link().mirrored())
    moved = (
        controls.State(down)
        .moved({"depth": 12.0, "height": 7.0, "lamp_x": 1.0, "tilt": 5.0})
        .scenario
    )
    assert (moved.link.receiver.depth, moved.link.receiver.tilt_deg) == (12.0, 5.0)
    assert (moved.link.transmitter.height, moved.link.transmitter.position) == (7.0, (1.0, 0.0))


def test_moves_act_on_the_link_as_given():
    state = controls.State(PAPER).moved({"wind": 0.0})
    assert state.scenario.surface.to_config()["kind"] == "flat"
    back = state.moved({"water": "jerlov-I"}).moved({"wind": 5.0, "water": controls.OWN})
    assert back == controls.State(PAPER)
    assert back.scenario == PAPER


def test_a_refused_move_names_the_value():
    state = controls.State(PAPER)
    for moves, field in (
        ({"depth": -1.0}, "transmitter.depth"),
        ({"fov": 400.0}, "receiver.fov_deg"),
        ({"wind": float("nan")}, "wind"),
        ({"depth": "deep"}, "depth"),
        ({"water": "jerlov-IX"}, "water"),
        ({"hieght": 1.0}, "hieght"),
    ):
        with pytest.raises(Refused, match=field):
            state.moved(moves)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", {"light": "none", "water": "own", "lamp": "LED", "detector": "physical",
              "aircraft": "none"}),
        ('[water]\ntype = "jerlov-II"\n[transmitter]\nkind = "gaussian-beam"\n'
         '[daylight]\nmodel = "overcast"\n[detector]\npreset = "paper"\nbit_rate = 2e6\n'
         '[uav]\npreset = "dji-m300-rtk"',
         {"light": "overcast", "water": "jerlov-II", "lamp": "laser", "detector": "paper",
          "aircraft": "dji-m300-rtk"}),
        ('[transmitter]\nkind = "isotropic"\n[uav]\nmass = 3', {"lamp": "own", "aircraft": "own"}),
    ],
)  # fmt: skip
def test_menus_begin_with_what_the_link_has(text, words):
    """Their first word was "as given", which told nothing."""
    state = controls.State(Scenario.from_toml(text))
    assert state.settings.items() >= words.items()
    assert state.moved(words) == state


def test_a_refusal_is_in_the_words_and_units_of_the_page():
    told = {}
    tried = {"fov": 400.0, "aperture": 0.0, "pde": 150.0, "depth": -1.0, "wind": 80.0, "a": -1.0,
             "seed": 1.5, "height": "x", "half_angle": 90.0, "fetch": 0.0}  # fmt: skip
    for name, value in tried.items():
        with pytest.raises(Refused) as error:
            controls.State(PAPER).moved({name: value})
        told[name] = readings.refusal(name, error.value)
    assert told == {
        "fov": "Field of view: above 0 to 180 degrees",
        "aperture": "Aperture radius: above 0 cm",
        "pde": "Efficiency: above 0 to 100 %",
        "depth": "Depth: above 0 to 12000 m",
        "wind": "Wind: 0 to 60 m/s",
        "a": "Absorption a: 0 or more 1/m",
        "seed": "Waves, seed: a whole number",
        "height": "Height: a number",
        "half_angle": "Half angle: 0.001 to below 90 degrees",
        "fetch": "Fetch: above 0 km",
    }


def test_links_without_a_value_have_no_such_control():
    sun = controls.State(scenario_of(mt.Link(transmitter=mt.Sun(), receiver=mt.WaterAperture())))
    missing = {name for name, value in sun.values.items() if value is None}
    assert missing == {"half_angle", "height", "tilt", "sun", "chlorophyll"}
    with pytest.raises(Refused, match="height"):
        sun.moved({"height": 3.0})


def test_the_first_of_several_parts_moves():
    two = mt.Link(receiver=(mt.Receiver(), mt.Receiver(height=9.0)))
    moved = controls.State(scenario_of(two)).moved({"height": 7.0, "offset_x": 1.0}).scenario.link
    assert [r.height for r in moved.receiver] == [7.0, 9.0]
    assert [r.position for r in moved.receiver] == [(1.0, 0.0), (0.0, 0.0)]


moves = st.fixed_dictionaries(
    {},
    optional={
        **{
            # a beam may not be as wide as an LED
            c.name: st.floats(max(c.low, 1.0), 59.0 if c.name == "half_angle" else c.high).map(
                lambda v, c=c: round(v, c.name != "seed")
            )
            for c in controls.CONTROLS
            if c.name not in ("sun", "wavelength", "chlorophyll")  # not with each light and water
        },
        **{name: st.sampled_from(choice.words) for name, choice in controls.CHOICES.items()},
    },
)


@given(moves)
def test_the_link_file_of_a_state_is_the_state(values):
    scenario = controls.State(GREEN).moved(values).scenario
    assert Scenario.from_toml(readings.as_toml(scenario)) == scenario


@pytest.mark.parametrize("numbers", [{}, {"a": 0.2}])
def test_both_texts_of_water_by_chlorophyll_describe_it(numbers):
    moved = {"water": controls.CASE_1, "chlorophyll": 2.0, "wavelength": 530.0, **numbers}
    scenario = controls.State(PAPER).moved(moved).scenario
    text, program = readings.as_toml(scenario), readings.as_python(scenario)
    assert Scenario.from_toml(text) == scenario
    assert ("chlorophyll = 2.0" in text) == ("Constituents(chlorophyll=2.0)" in program)
    assert ("chlorophyll = 2.0" in text) == (not numbers)
    made = {}
    exec(program[: program.index("result = ")], made)
    assert made["link"] == scenario.link


@given(moves)
def test_the_program_of_a_state_makes_the_same_link_and_sea(values):
    scenario = controls.State(GREEN).moved(values).scenario
    lines = readings.as_python(scenario)
    made = {}
    exec(lines[: lines.index("result = ")], made)
    assert made["link"] == scenario.link
    assert made["sea"] == scenario.surface


def test_the_program_prints_the_gain_and_the_error_rate(capsys):
    state = controls.State(PAPER).moved({"bit_rate": 5.0, "depth": 20.0})
    scenario = controls.begun_at(state.scenario, 1.5)
    exec(compile(readings.as_python(scenario), "program", "exec"), {})
    result = mt.simulate(scenario, photons=10_000)
    printed = capsys.readouterr().out
    assert f"{result.gain:.4e}" in printed
    assert result.gain != mt.simulate(state.scenario, photons=10_000).gain
    seen = mt.impulse_response(mt.simulate(scenario, photons=10_000, record=[mt.Arrivals()]))
    response = mt.comms.ChannelResponse.from_arrivals(seen.delay, seen.weight, seen.angle)
    bits = mt.OokLink.of_link(scenario.link, bit_rate=5e6).replace(response=response)
    assert f"{float(bits.ber(bits.received_power(result.gain))):.3g}" in printed


@pytest.mark.parametrize("light", ["clear", "overcast", "moon", "night"])
def test_the_texts_of_a_link_by_day_name_the_model_of_its_light(light):
    """Irradiances once stood in both texts: a changed sun changed nothing."""
    scenario = controls.State(PAPER).moved({"light": light}).scenario
    assert "direct" not in readings.as_toml(scenario)
    program = readings.as_python(scenario)
    assert "direct" not in program
    day = re.search(r"mt\.Daylight\.\w+\(\)", program)[0]
    assert eval(day, {"mt": mt}) == scenario.daylight
    sun = Scenario.from_toml(
        readings.as_toml(scenario).replace("zenith_deg = 30.0", "zenith_deg = 70.0")
    )
    changed = sun.daylight.irradiance / scenario.daylight.irradiance
    assert (changed < 0.5) == (light != "night")


def test_objects_of_no_public_class_are_read_from_a_link_file(tmp_path, monkeypatch):
    (tmp_path / "my_phase.py").write_text(
        "import numpy as np\nimport meshtrace as mt\n"
        "class Even(mt.PhaseFunction, frozen=True):\n"
        "    kind: str = 'my_phase:Even'\n"
        "    def density(self, cos_theta):\n        return np.full_like(cos_theta, 0.5)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    scenario = Scenario.from_toml('[water.phase]\nkind = "my_phase:Even"', trust=True)
    made = {}
    program = readings.as_python(scenario)
    exec(program[: program.index("print(")], made)
    assert made["scenario"] == scenario


def test_slider_ranges_hold_the_value():
    for control in controls.CONTROLS:
        for value in (control.low / 3.0, control.low, 0.5 * control.high, 7.0 * control.high):
            low, high = controls.slider_range(control, value)
            assert low <= value <= high


def test_links_that_no_file_can_hold_are_refused_at_the_start():
    mesh = mt.surfaces.FlatSea().mesh(extent=30.0, spacing=1.0)
    with pytest.raises(Refused, match="surface"):
        scenario_of(mt.Link(), mesh)
