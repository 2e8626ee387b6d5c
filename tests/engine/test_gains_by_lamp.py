"""Gains by lamp: sums over the lamps are the gain, and light comes from the lamp that it is given to."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea

# few chains and photons: the numbers are compared, not their errors
pytestmark = pytest.mark.filterwarnings("ignore:.*effective sample size")

FLAT, SEA = FlatSea(), JonswapSea(wind_speed=5.0, waves="paper")
PLACES = (0.0, 0.0), (30.0, 0.0)


def link(radius=0.05, **fields):
    """Return two lamps 30 m apart, each below a receiver that sees no light of the other."""
    powers = 30.0, 120.0
    lamps = [
        mt.Led(depth=5.0, position=place, power_mw=power, half_angle_deg=15.0)
        for place, power in zip(PLACES, powers, strict=True)
    ]
    receivers = [mt.Receiver(height=5.0, position=place, radius=radius) for place in PLACES]
    return mt.Link(transmitter=lamps, receiver=receivers, **fields)


def down():
    lamps = [mt.AirLed(height=5.0, position=place, half_angle_deg=15.0) for place in PLACES]
    receivers = [mt.WaterReceiver(depth=5.0, position=place) for place in PLACES]
    return mt.Link(transmitter=lamps, receiver=receivers)


TURBID = mt.Water(a=0.3, b=4.0)  # where joined photons carry the scattered light
BOTTOM = mt.Water(a=0.1, b=0.05, bottom_depth=8.0, bottom_albedo=0.3)
RUNS = {
    "chains": (link(), {"photons": 64}),
    "joined": (link(water=TURBID), {"photons": 32}),
    "downlink": (down(), {"photons": 64}),
    "downlink with a bottom": (down().replace("water", BOTTOM), {"photons": 32}),
    "analog": (link(radius=2.0), {"estimator": "analog", "photons": 20_000, "first_photon": 7}),
}


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.slow_but("chains", "downlink", "analog")
def test_sums_over_lamps_are_the_gain(name):
    """Far apart each receiver sees its lamp: a photon given to another lamp would show."""
    ends, options = RUNS[name]
    run = {"seed": 3, "threads": 1, **options}
    whole, parts = (mt.simulate(ends, FLAT, **run, per_lamp=flag) for flag in (False, True))
    assert whole.gain_by_lamp is None
    np.testing.assert_allclose(parts.gain, whole.gain, rtol=1e-13)
    np.testing.assert_allclose(parts.gain_stderr, whole.gain_stderr, rtol=1e-9)
    np.testing.assert_allclose(parts.gain_by_lamp.sum(axis=0), whole.gain, rtol=1e-13)
    assert parts.scattered == whole.scattered
    assert parts.reflected == whole.reflected
    # joint errors: the scatter of the sums of the groups is that of the gain
    groups = parts.gain_by_lamp_groups.sum(axis=0)
    np.testing.assert_allclose(groups.mean(axis=-1), whole.gain, rtol=1e-12)
    if name != "analog":
        stderr = groups.std(axis=-1, ddof=1) / np.sqrt(32)
        assert (stderr <= whole.gain_stderr * (1.0 + 1e-9)).all()
    crossed = parts.gain_by_lamp[[0, 1], [1, 0]]
    assert (crossed < 1e-3 * whole.gain.min()).all()
    assert (parts.gain_by_lamp.diagonal() > 0.0).all()


def test_lamps_alone():
    """Over still water without scattering the parts are the gains of each lamp by itself."""
    ends = link(water=mt.Water(a=0.1, b=0.0)).replace("transmitter.1.position", (0.3, 0.0))
    parts = mt.simulate(ends, FLAT, photons=32, per_lamp=True).gain_by_lamp
    for lamp, source in enumerate(ends.transmitters):
        alone = mt.simulate(ends.replace("transmitter", source), FLAT, photons=32).gain
        np.testing.assert_allclose(parts[lamp], source.power_mw / 150.0 * alone, rtol=1e-5)


@pytest.mark.slow
def test_wavelengths_and_files(tmp_path):
    ends = link(water=mt.Water.from_type("jerlov-II"))
    run = {"photons": 32, "threads": 1, "wavelengths_nm": [450.0, 500.0]}
    whole, parts = (mt.simulate(ends, FLAT, **run, per_lamp=flag) for flag in (False, True))
    np.testing.assert_allclose(parts["gain_by_lamp"].sum("transmitter"), whole["gain"], rtol=1e-12)
    (_, first), _ = parts
    first.save(tmp_path / "gain.nc")
    np.testing.assert_array_equal(
        mt.results.load(tmp_path / "gain.nc").gain_by_lamp_groups, first.gain_by_lamp_groups
    )
    assert "by lamp" in first.summary()


def test_merged_runs():
    ends, options = RUNS["analog"]
    options = options | {"photons": 4096, "per_lamp": True, "threads": 1}
    runs = [mt.simulate(ends, FLAT, **options | {"first_photon": 4096 * i}) for i in range(2)]
    merged = mt.merge(runs)
    np.testing.assert_allclose(merged.gain_by_lamp.sum(axis=0), merged.gain, rtol=1e-13)
    np.testing.assert_allclose(
        merged.gain_by_lamp_groups.mean(axis=-1), merged.gain_by_lamp, rtol=1e-12
    )


def close_ends():
    """Return two lamps and two receivers within each other's light."""
    ends = link().replace("transmitter.1.position", (0.3, 0.0))
    return ends.replace("receiver.1.position", (0.2, 0.0))


def test_series_ensembles_and_traces(tmp_path):
    run = {"photons": 32, "threads": 1, "spacing": 0.5}
    ends, times = close_ends(), [0.0, 0.02, 0.04]
    whole = mt.time_series(ends, SEA, times, **run)
    parts = mt.time_series(ends, SEA, times, per_lamp=True, **run)
    np.testing.assert_allclose(parts.gain, whole.gain, rtol=1e-13)
    np.testing.assert_allclose(parts.gain_by_lamp.sum(axis=1), whole.gain, rtol=1e-13)
    np.testing.assert_allclose(
        parts.gain_by_lamp_groups.mean(axis=-1), parts.gain_by_lamp.mean(axis=0), rtol=1e-12
    )
    parts.save(tmp_path / "series.nc")
    restored = mt.results.load(tmp_path / "series.nc")
    np.testing.assert_array_equal(restored.gain_by_lamp, parts.gain_by_lamp)
    assert parts.correlation.shape == (4, 4)
    assert "lamp 0, receiver 0 and lamp 1, receiver 1" in restored.summary()
    seas = mt.ensemble(ends, 3, SEA, per_lamp=True, **run)
    np.testing.assert_allclose(seas.gain_by_lamp.sum(axis=1), seas.gain, rtol=1e-13)
    trace = mt.channel_trace(ends, SEA, hours=3.0 / 50.0 / 3600.0, down=None, per_lamp=True, **run)
    np.testing.assert_allclose(trace.gain_by_lamp.sum(axis=1), trace.gain, rtol=1e-13)
    assert trace.series().correlation.shape == (4, 4)


def test_analog_series():
    run = {"threads": 1, "mesh": mt.options.Meshing(extent=60.0, spacing=4.0)}
    text = 'wind_speed = 5.0\n[run]\nestimator = "analog"\nphotons = 4096'
    scenario = mt.Scenario.from_toml(text).replace("link", link(radius=2.0))
    seas = mt.ensemble(scenario, 2, SEA, per_lamp=True, **run)
    np.testing.assert_allclose(seas.gain_by_lamp.sum(axis=1), seas.gain, rtol=1e-13)
