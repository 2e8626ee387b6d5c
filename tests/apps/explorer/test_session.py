"""A session: its answers are those of the library for the newest state."""

import re
import threading
import warnings

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.apps.explorer import controls, influences, readings, stages
from meshtrace.apps.explorer.session import STAGES, Failed, Session, Superseded
from meshtrace.comms.budget import link_budget
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario
from meshtrace.surfaces import JonswapSea

PAPER = Scenario.from_toml("")


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Make the series and the maps short."""
    monkeypatch.setattr(stages, "FADING_FRAMES", 16)
    monkeypatch.setattr(stages, "MAP_PHOTONS", (5_000, 20_000))
    monkeypatch.setattr(influences, "INPUTS", ())


@pytest.fixture
def session():
    session = Session(PAPER)
    yield session
    session.close()
    session.join()


def test_gain_and_bits_are_those_of_the_library(session):
    session.move({"depth": 45.0, "bit_rate": 5.0})
    assert session.wait(120.0)
    found = session.answer("gain")
    link = PAPER.link.replace("transmitter.depth", 45.0)
    expected = mt.simulate(PAPER.replace(link=link), photons=stages.CHAINS[-1])
    assert found.gain.gain == expected.gain
    assert found.gain.gain_stderr == expected.gain_stderr
    assert found.gain.gain_ballistic == expected.gain_ballistic
    ook = mt.OokLink.of_link(link, bit_rate=5e6).replace(response=response_at(link))
    budget = link_budget(ook, expected.gain, 1e-3)
    power = float(ook.received_power(expected.gain))
    assert found.ber == float(ook.ber(power))
    assert 1e-6 < found.ber < 0.5  # or the test would compare zeros
    shown = readings.gain_reading(session)
    assert shown["ber"] == f"{found.ber:.2e}"
    assert shown["power"].startswith(f"{readings.power(power)} ± ")
    assert shown["required"] == readings.power(1e-3 * 10.0 ** (0.1 * budget.required_dbm))
    assert shown["margin"] == f"{budget.margin_optical_db:+.1f} dB".replace("-", "−")
    assert shown["verdict"] == ("closes" if budget.margin_optical_db >= 0.0 else "dead")
    assert shown["db"] == f"−{-10 * np.log10(expected.gain):.2f} dB"


@pytest.mark.thorough
@pytest.mark.parametrize("wind", [3.0, 13.0])
def test_tilts_beyond_the_field_of_view_are_named_as_by_a_performance(wind):
    session = Session(Scenario.from_toml("[uav]\npreset = 'dji-m300-rtk'"))
    try:
        session.move({"wind": wind})
        assert session.wait(120.0)
        notes = [n for n in session.answer("gain").notes if n.startswith("tilt of the aircraft")]
    finally:
        session.close()
        session.join()
    report = mt.link_performance(session.state.scenario, photons=512, realizations=2)
    assert notes == report._tilts()
    assert len(notes) == (wind == 13.0)


def response_at(link, scenario=PAPER):
    """Return the response of the channel, of a separate run."""
    at = scenario.replace(link=link)
    run = mt.simulate(at, photons=stages.CHAINS[-1], record=[mt.Arrivals()])
    seen = mt.impulse_response(run)
    return mt.comms.ChannelResponse.from_arrivals(seen.delay, seen.weight, seen.angle)


@pytest.mark.parametrize(("rate", "counts"), [(30.0, True), (1.0, False)])
def test_the_error_rate_is_that_of_a_performance_behind_the_response(session, rate, counts):
    """Pulses once spread by no water, however turbid."""
    session.move({"wind": 0.0, "b": 0.3, "a": 0.05, "depth": 8.0, "bit_rate": rate})
    assert session.wait(120.0)
    found, scenario = session.answer("gain"), session.state.scenario
    at = mt.link_performance(scenario, photons=stages.CHAINS[-1], realizations=2).at()
    assert found.ber == pytest.approx(at.ber.value, rel=1e-9, abs=1e-200)
    prompt = found.detector.replace(response=None)
    if counts:
        power = prompt.received_power(found.gain.gain)
        assert abs(found.ber / float(prompt.ber(power)) - 1.0) > 1e-3
    told = readings.gain_reading(session)["spread"]
    assert told.startswith("0.35 ns, ")
    assert ("bit" in told) == counts


@pytest.mark.thorough
def test_daylight_changes_the_bits_alone(session):
    session.move({"depth": 30.0})
    assert session.wait(120.0)
    dark, rays = session.answer("gain"), session._answers["rays"]
    session.move({"light": "clear"})
    assert session.wait(240.0)
    lit, scenario = session.answer("gain"), session.state.scenario
    assert lit.gain.gain == dark.gain.gain
    assert session._answers["rays"] is rays
    found = mt.background(scenario, photons=stages.BACKGROUND_RAYS)
    ook = mt.OokLink.of_link(scenario.link)
    ook = ook.replace(response=response_at(scenario.link))
    ook = ook.replace(background_rate=found.count_rate(ook))
    assert lit.detector.background_rate == ook.background_rate > 1e6
    assert readings.gain_reading(session)["background"].endswith(" counts/s")
    assert readings.gain_reading(session)["light"] == "clear sky"
    assert readings._bits(dark)["background"] == "–"
    assert readings._bits(dark)["light"] == "dark"
    assert lit.ber == float(ook.ber(ook.received_power(lit.gain.gain))) > dark.ber
    assert (dark.daylight, dark.detector.background_rate) == ("", 0.0)


def test_light_downwards(session):
    from meshtrace.apps.explorer import scenario_of

    down = Session(scenario_of(mt.Link().mirrored(), PAPER.surface))
    down.answer_now()
    assert down.wait(240.0)
    expected = mt.simulate(mt.Link().mirrored(), PAPER.surface, photons=8192)
    assert down.answer("gain").gain.gain == expected.gain
    assert len(down.answer("rays").what) == stages.RAYS
    assert len(down.answer("fading").gain) == 16
    down.close()
    down.join()


@pytest.mark.thorough
def test_the_series_is_that_of_the_library(session):
    session.answer_now()
    assert session.wait(120.0)
    found = session.answer("fading")
    times = np.arange(16) / stages.FADING_RATE
    expected = mt.time_series(PAPER, times, photons=stages.FADING_CHAINS)
    np.testing.assert_array_equal(found.time, times)
    np.testing.assert_array_equal(found.gain, expected.gain)
    assert expected.provenance["surface"]["omega_max"] == 19.74  # all waves, not 4.1 rad/s
    assert found.index_of_all == stages.index_of_all(PAPER.link, PAPER.surface)
    assert found.index.value == pytest.approx(
        expected.gain.var(ddof=1) / expected.gain.mean() ** 2, rel=1e-9
    )


@pytest.mark.parametrize(("x", "expected"), [(0.0, 0.317), (2.0, None)])
def test_the_index_of_all_waves_stands_beside_the_series(x, expected):
    """At 5 m/s the band of the sea has 0.005; off the axis there is no closed form."""
    link = mt.Link(receiver=mt.Receiver(height=5.0, position=(x, 0.0)))
    found = stages.index_of_all(link, JonswapSea(wind_speed=5.0))
    assert found == (expected and pytest.approx(expected, rel=0.01))


def test_uncertain_gains_are_left_out(session, monkeypatch):
    monkeypatch.setattr(stages, "_MOST_ERROR", 0.0)
    session.answer_now()
    assert session.wait(120.0)
    found = session.answer("fading")
    assert (len(found.gain), found.left_out, found.index) == (0, 16, None)


@pytest.mark.thorough
def test_only_answers_that_depend_on_a_move_are_made_again(session):
    session.answer_now()
    assert session.wait(120.0)
    before = {name: session._answers[name] for name in ("gain", "rays", "fading")}
    session.move({"bit_rate": 3.0})
    assert not session.fresh("gain")
    assert session.fresh("rays")
    assert session.fresh("fading")
    assert session.wait(120.0)
    assert session.fresh("gain")
    assert session.answer("gain").gain.gain == before["gain"].value.gain.gain
    assert session._answers["rays"] is before["rays"]
    session.show_time(0.5)
    session.answer_now()
    assert session.wait(120.0)
    assert session._answers["fading"] is before["fading"]
    assert session.answer("rays") is not before["rays"].value
    expected = mt.simulate(PAPER, photons=stages.CHAINS[-1], time=0.5)
    assert session.answer("gain").gain.gain == expected.gain


def test_the_newest_move_wins(monkeypatch):
    seen, blocked, go_on = [], threading.Event(), threading.Event()
    real = stages.gains

    def slow(state, check):
        seen.append(state.values["depth"])
        if len(seen) == 1:
            blocked.set()
            assert go_on.wait(30.0)
        yield from real(state, check)

    session = Session(PAPER)
    monkeypatch.setitem(STAGES, "gain", slow)
    session.move({"depth": 11.0})
    assert blocked.wait(30.0)
    for depth in (12.0, 13.0, 14.0):
        session.move({"depth": depth})
    assert session.answer("gain") is None
    go_on.set()
    assert session.wait(120.0)
    assert seen == [11.0, 14.0]
    expected = mt.simulate(PAPER.replace(link=PAPER.link.at_depth(14.0)), photons=8192)
    assert session.answer("gain").gain.gain == expected.gain
    session.close()
    session.join()


def test_answers_come_in_order_and_stale_ones_are_marked(session):
    names = []
    session._on_answer = names.append
    session.answer_now()
    assert session.wait(120.0)
    assert [n for i, n in enumerate(names) if n != names[i - 1] or i == 0] == [
        "gain", "rays", "fading", "influences", "",
    ]  # fmt: skip
    session.close()
    session.move({"depth": 11.0})
    assert not any(session.fresh(name) for name in ("gain", "rays", "fading", "map"))


@pytest.mark.thorough
def test_a_map_is_made_on_demand(session):
    session.answer_now()
    session.make_map()
    assert session.wait(240.0)
    found = session.answer("map")
    assert session.fresh("map")
    assert found.gain.shape == (stages.MAP_CELLS, stages.MAP_CELLS)
    expected = mt.coverage_map(
        PAPER, extent=7.5, step=15.0 / stages.MAP_CELLS, photons=20_000, times=(0.0,)
    )
    np.testing.assert_array_equal(found.gain, expected.gain)
    session.move({"depth": 11.0})
    assert session.wait(120.0)
    assert not session.fresh("map")


def test_the_map_of_a_downlink_is_as_wide_as_the_link_is_high():
    """It once reached 0.5 m, as if neither end had a height."""
    down = controls.State(Scenario.from_toml(
        '[transmitter]\nkind = "air-led"\nheight = 5\n[receiver]\nkind = "water-receiver"\ndepth = 9\n'
    ))  # fmt: skip
    found = next(stages.coverage(down, lambda *_: None))
    width = np.ptp(found.x) * stages.MAP_CELLS / (stages.MAP_CELLS - 1)
    assert width == pytest.approx(5.0 + 9.0)


def test_a_refused_move_keeps_the_state(session):
    session.answer_now()
    before = session.state
    with pytest.raises(Refused, match="fov"):
        session.move({"fov": 200.0})
    assert session.state is before


def test_a_link_that_cannot_be_traced_says_why(session):
    session.move({"height": 0.01})
    assert session.wait(120.0)
    failed = session.answer("gain")
    assert isinstance(failed, Failed)
    assert "above the highest crest" in failed
    assert readings.gain_reading(session)["notes"] == [failed]
    session.move({"height": 5.0})
    assert session.wait(120.0)
    assert session.answer("gain").gain.gain == mt.simulate(PAPER, photons=8192).gain


@pytest.mark.thorough
def test_internal_errors_are_shown_and_work_goes_on(session, monkeypatch):
    monkeypatch.setattr(stages, "simulate", lambda *args, **options: 1 / 0)
    session.answer_now()
    assert session.wait(30.0)
    assert "ZeroDivisionError" in session.answer("gain")
    monkeypatch.undo()
    session.move({"depth": 11.0})
    assert session.wait(240.0)
    assert session.answer("gain").gain.gain > 0.0


@pytest.mark.thorough
def test_two_sessions_do_not_mix():
    one, two = Session(PAPER), Session(PAPER)
    one.move({"depth": 11.0})
    two.move({"height": 8.0})
    one.move({"wind": 7.0})
    assert one.wait(240.0)
    assert two.wait(240.0)
    assert dict(one.state.moves) == {"depth": 11.0, "wind": 7.0}
    assert dict(two.state.moves) == {"height": 8.0}
    for session in (one, two):
        expected = mt.simulate(session.state.scenario, photons=8192)
        assert session.answer("gain").gain.gain == expected.gain
        session.close()
        session.join()


@pytest.mark.thorough
def test_warnings_are_notes_of_their_gain(session):
    session.move({"tilt": 60.0, "fov": 20.0})
    assert session.wait(240.0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mt.simulate(session.state.scenario, photons=8192)
    assert any(issubclass(w.category, mt.FewSamplesWarning) for w in caught)
    assert session.answer("gain").notes == tuple(" ".join(str(w.message).split()) for w in caught)


@pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning")
@pytest.mark.parametrize("name", controls.STARTS)
@pytest.mark.slow_but("calm", "deep")
def test_the_margin_of_a_start_is_the_present_one(name):
    """They are kept in a file: docs/scripts/make_explorer_starts.py makes them anew."""
    start, state = controls.STARTS[name], controls.State(controls.start_of(name))
    *_, signal = stages.gains(state.at(start["time"]), lambda *_: None)
    margin = float(link_budget(signal.detector, signal.gain.gain, stages.LIMIT).margin_optical_db)
    # the samples are the same: what other processors round differently is far below the digit
    assert margin == pytest.approx(start["margin"], abs=0.06)
    assert (start["verdict"] == "dead") == (margin < 0.0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", controls.STARTS)
def test_the_answers_of_a_start_are_the_present_ones(name):
    start = controls.STARTS[name]
    found = readings.answer_of_start(Scenario.from_config(start["link"]))
    assert found == {key: start[key] for key in found}
    assert {start["verdict"] for start in controls.STARTS.values()} == {"closes", "fades", "dead"}


def test_the_sea_stands_quiet_at_the_start(monkeypatch):
    """Seed 0 begins in a flash of 2.3 times the mean."""
    monkeypatch.setattr(stages, "FADING_FRAMES", 96)
    times = np.arange(0, stages.FADING_FRAMES, 2) / stages.FADING_RATE
    gain = mt.time_series(PAPER, times, photons=stages.FADING_CHAINS).gain
    time = stages.quiet_time(PAPER)
    found = mt.time_series(PAPER, [0.0, time], photons=stages.FADING_CHAINS).gain / gain.mean()
    assert found[0] > 1.8
    assert found[1] == pytest.approx(1.0, abs=0.12)
    assert stages.quiet_time(controls.begun_at(PAPER, 2.5)) == 2.5
    assert stages.quiet_time(PAPER.replace(surface=mt.surfaces.FlatSea())) == 0.0


def test_the_steps_of_the_budget_add_up():
    link = mt.Link()
    gain = mt.simulate(link, mt.surfaces.FlatSea(), photons=64)
    detector = mt.OokLink.of_link(link, bit_rate=1e6)
    lines = readings.budget(stages.Signal(gain, detector=detector), link)
    value = {b["name"]: float(b["text"].split()[0].replace("−", "-")) for b in lines}
    names = "lost in the water", "scattered in", "spread, surface", "lens, filter"
    assert value["lost in the water"] == pytest.approx(-4.343 * link.water.c * 10.0, abs=0.06)
    total = value["lamp"] + sum(value[name] for name in names)
    assert total == pytest.approx(value["received"], abs=0.3)  # of rounded steps
    assert value["received"] - value["needed"] == pytest.approx(value["margin"], abs=0.11)
    assert all(0.0 <= b["left"] <= b["left"] + b["width"] <= 100.0 + 1e-9 for b in lines)


def test_one_quantity_has_one_scale(session):
    """Gains were a number in dB, one times a power of ten, ratios, and a linear map."""
    session.make_map()
    assert session.wait(240.0)
    shown, fading = readings.gain_reading(session), readings.fading_reading(session)
    assert re.fullmatch(r"± 0\.\d+ dB", shown["error"])
    relative = 10.0 ** (0.1 * np.array(fading["gain"]))
    assert relative.mean() == pytest.approx(1.0, abs=1e-3)
    image = readings.map_image(session.answer("map"))
    assert all(re.match(r"−\d+(\.\d+)? dB", image[key]) for key in ("most", "least", "peak"))


@pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning")  # of the dead link
def test_a_link_closes_fades_or_is_dead():
    """The verdict is that of the margin, and of the darkest moments of a moving sea."""
    link = mt.Link()
    detector = mt.OokLink.of_link(link, bit_rate=1e6)
    gain = mt.simulate(link, mt.surfaces.FlatSea(), photons=64)
    signal = stages.Signal(gain, detector=detector)
    margin = float(link_budget(detector, gain.gain, 1e-3).margin_optical_db)
    assert margin > 3.0
    spared = {"verdict": "closes", "verdict_text": f"Closes: {margin:.1f} dB to spare"}
    times, needed = np.arange(4.0), gain.gain * 10.0 ** (-0.1 * margin)
    assert readings.verdict(signal, None) == spared
    assert readings.verdict(signal, stages.Fading(times, np.full(4, 1.1 * needed))) == spared
    dark = stages.Fading(times, needed * np.array([0.9, 1.1, 2.0, 2.0]))
    assert readings.verdict(signal, dark)["verdict_text"] == "Fades: too dark in 25 %"
    deep = mt.simulate(link.at_depth(120.0), mt.surfaces.FlatSea(), photons=64)
    assert readings.verdict(stages.Signal(deep, detector=detector), None)["verdict"] == "dead"


@pytest.mark.thorough
def test_the_inputs_that_move_the_margin_most_are_told_with_their_errors(session, monkeypatch):
    monkeypatch.setattr(influences, "INPUTS", ("a", "depth", "power", "wind"))
    monkeypatch.setattr(influences, "_SEAS", 4)
    session.answer_now()
    assert session.wait(120.0)
    by_name = {i.name: i for i in session.answer("influences")}
    assert set(by_name) == {"a", "depth", "power", "wind"}
    # the margin is in optical decibels: a tenth more power, and the law of the elasticity by a
    assert by_name["power"].change == pytest.approx(10.0 * np.log10(1.1), abs=1e-9)
    assert by_name["power"].stderr == 0.0
    (row,) = mt.sensitivities(PAPER, wrt=["water.a"], photons=2048).table
    # exp(-a L) over paths of nearly one length: dB in proportion to the step
    expected = 10.0 / np.log(10.0) * 0.1 * row.elasticity
    assert by_name["a"].change == pytest.approx(expected, rel=0.02)
    assert by_name["wind"].stderr > by_name["a"].stderr > 0.0
    lines = readings.influences(session)
    assert lines[0]["step"] == "+10 % of depth"
    assert re.fullmatch(r"−\d\.\d+ ± 0\.\d+ dB", lines[0]["change"])
    session.move({"depth": 11.0})
    assert not session.fresh("influences")


def test_a_move_ends_the_work_on_inputs(monkeypatch):
    """The gain of the newest state never waits for the inputs of the state before."""

    def moved():
        raise Superseded

    monkeypatch.setattr(influences, "INPUTS", ("a",))
    calls = iter([None] * 3)
    check = lambda *_: next(calls, "over") and moved()  # noqa: E731
    with pytest.raises(Superseded):
        list(influences.influences(controls.State(PAPER), check))
