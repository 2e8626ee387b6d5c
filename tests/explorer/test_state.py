"""The state: each control moves the value that it names, and both texts describe the same link."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.explorer.code import as_python, as_toml
from meshtrace.explorer.controls import BY_NAME, CHOICES, CONTROLS, GIVEN, State, slider_range
from meshtrace.explorer.launch import scenario_of
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
}
PAPER = Scenario.from_toml("")
GREEN = Scenario.from_toml("[transmitter]\nwavelength_nm = 514.0")
"""A link at the wavelength of all types of water."""


def test_every_control_has_an_effect_to_test():
    assert list(EFFECTS) == list(BY_NAME)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_control_moves_its_value_and_no_other(name):
    value, effect = EFFECTS[name]
    state = State(PAPER)
    moved = state.moved({name: value})
    assert effect(moved.scenario)
    assert not effect(state.scenario) if name != "bit_rate" else state.scenario.detector is None
    assert moved.values == {**state.values, name: value}


@pytest.mark.parametrize("water", CHOICES["water"])
def test_the_water_is_that_of_the_type(water):
    state = State(GREEN).moved({"water": water})
    expected = PAPER.link.water if water == GIVEN else mt.Water.from_type(water, 514.0)
    assert state.scenario.link.water == expected
    assert state.settings["water"] == water


@pytest.mark.parametrize("light", CHOICES["light"])
def test_the_light_is_that_of_the_link_file(light):
    state = State(PAPER).moved({"light": light})
    text = "" if light == GIVEN else f'[daylight]\nmodel = "{light}"'
    assert state.scenario.daylight == Scenario.from_toml(text).daylight
    assert state.channel == PAPER


def test_links_downwards_move_as_well():
    down = scenario_of(mt.Link().mirrored())
    moved = State(down).moved({"depth": 12.0, "height": 7.0, "lamp_x": 1.0, "tilt": 5.0}).scenario
    assert (moved.link.receiver.depth, moved.link.receiver.tilt_deg) == (12.0, 5.0)
    assert (moved.link.transmitter.height, moved.link.transmitter.position) == (7.0, (1.0, 0.0))


def test_moves_act_on_the_link_as_given():
    state = State(PAPER).moved({"wind": 0.0})
    assert state.scenario.surface.to_config()["kind"] == "flat"
    back = state.moved({"water": "jerlov-I"}).moved({"wind": 5.0, "water": GIVEN})
    assert back == State(PAPER)
    assert back.scenario == PAPER


def test_a_refused_move_names_the_value():
    state = State(PAPER)
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


def test_links_without_a_value_have_no_such_control():
    sun = State(scenario_of(mt.Link(transmitter=mt.Sun(), receiver=mt.WaterAperture())))
    missing = {name for name, value in sun.values.items() if value is None}
    assert missing == {"half_angle", "height", "tilt"}
    with pytest.raises(Refused, match="height"):
        sun.moved({"height": 3.0})


def test_the_first_of_several_parts_moves():
    two = mt.Link(receiver=(mt.Receiver(), mt.Receiver(height=9.0)))
    moved = State(scenario_of(two)).moved({"height": 7.0, "offset_x": 1.0}).scenario.link
    assert [r.height for r in moved.receiver] == [7.0, 9.0]
    assert [r.position for r in moved.receiver] == [(1.0, 0.0), (0.0, 0.0)]


moves = st.fixed_dictionaries(
    {},
    optional={
        **{c.name: st.floats(max(c.low, 1.0), c.high).map(lambda v: round(v, 2)) for c in CONTROLS},
        "water": st.sampled_from(CHOICES["water"]),
        "light": st.sampled_from(CHOICES["light"]),
    },
)


@given(moves)
def test_the_link_file_of_a_state_is_the_state(values):
    scenario = State(GREEN).moved(values).scenario
    assert Scenario.from_toml(as_toml(scenario)) == scenario


@given(moves)
def test_the_program_of_a_state_makes_the_same_link_and_sea(values):
    scenario = State(GREEN).moved(values).scenario
    lines = as_python(scenario)
    made = {}
    exec(lines[: lines.index("result = ")], made)
    assert made["link"] == scenario.link
    assert made["sea"] == scenario.surface


def test_the_program_prints_the_gain_and_the_error_rate(capsys):
    state = State(PAPER).moved({"bit_rate": 5.0, "depth": 20.0})
    exec(compile(as_python(state.scenario), "program", "exec"), {})
    result = mt.simulate(state.scenario, photons=10_000)
    printed = capsys.readouterr().out
    assert f"{result.gain:.4e}" in printed
    bits = mt.OokLink.of_link(state.scenario.link, bit_rate=5e6)
    assert f"{float(bits.ber(bits.received_power(result.gain))):.3g}" in printed


@pytest.mark.parametrize("light", ["clear", "overcast", "moon", "night"])
def test_the_texts_of_a_link_by_day_name_the_model_of_its_light(light):
    """Irradiances once stood in both texts: a changed sun changed nothing."""
    scenario = State(PAPER).moved({"light": light}).scenario
    assert "direct" not in as_toml(scenario)
    program = as_python(scenario)
    assert "direct" not in program
    day = re.search(r"mt\.Daylight\.\w+\(\)", program)[0]
    assert eval(day, {"mt": mt}) == scenario.daylight
    sun = Scenario.from_toml(as_toml(scenario).replace("zenith_deg = 30.0", "zenith_deg = 70.0"))
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
    program = as_python(scenario)
    exec(program[: program.index("print(")], made)
    assert made["scenario"] == scenario


def test_slider_ranges_hold_the_value():
    for control in CONTROLS:
        for value in (control.low / 3.0, control.low, 0.5 * control.high, 7.0 * control.high):
            low, high = slider_range(control, value)
            assert low <= value <= high


def test_links_that_no_file_can_hold_are_refused_at_the_start():
    mesh = mt.surfaces.FlatSea().mesh(extent=30.0, spacing=1.0)
    with pytest.raises(Refused, match="surface"):
        scenario_of(mt.Link(), mesh)
