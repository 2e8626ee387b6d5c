"""Sums of seas, and waves in a uniform current."""

import math
import pickle
import tomllib

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.scenario import Scenario
from meshtrace.surfaces import (
    FlatSea,
    Jonswap,
    JonswapSea,
    MeasuredSea,
    SpectralSea,
    SumSea,
    sea_from_config,
)
from meshtrace.surfaces.statistics import components_hs
from meshtrace.surfaces.waves import (
    angular_frequency,
    group_speed,
    wavenumber,
    wavenumber_in_current,
)

WIND_SEA = JonswapSea(wind_speed=8.0, seed=1)
SWELL = SpectralSea(spectrum=Jonswap(hs=1.0, tp=12.0, gamma=6.0), mss="band", wind_direction_deg=90)
SEA = SumSea(parts=[WIND_SEA, SWELL], seed=3)

# ---- sums ------------------------------------------------------------------------------------


def test_a_sum_is_the_sum_of_its_parts():
    x, y = np.array([0.3, -2.0, 5.0]), np.array([1.0, 0.0, -4.0])
    seeds = [int(np.random.SeedSequence([3, i]).generate_state(1)[0]) for i in range(2)]
    parts = [part.with_seed(seed) for part, seed in zip((WIND_SEA, SWELL), seeds, strict=True)]
    z = sum(part.elevation(x, y, 2.5) for part in parts)
    np.testing.assert_allclose(SEA.elevation(x, y, 2.5), z, rtol=1e-12, atol=1e-14)
    heights = [components_hs(part.components) for part in (WIND_SEA, SWELL)]
    assert components_hs(SEA.components) == pytest.approx(math.hypot(*heights), rel=1e-12)


def test_slopes_beyond_the_mesh_are_those_of_the_wind_sea():
    assert SEA.slope_variance == WIND_SEA.slope_variance
    left_out = SEA.unresolved_slopes(0.1)
    # the swell takes its own slopes from them
    assert 0.0 < sum(left_out.vertex) < sum(WIND_SEA.unresolved_slopes(0.1).vertex)
    assert SumSea(parts=[SWELL]).unresolved_slopes(0.1) is None


def test_sums_go_through_plain_data_pickles_and_link_files():
    assert sea_from_config(SEA.to_config()) == SEA
    assert pickle.loads(pickle.dumps(SEA)) == SEA
    np.testing.assert_array_equal(
        SEA.with_seed(4).mesh(extent=1.0).vertices,
        SumSea(parts=SEA.parts, seed=4).mesh(extent=1.0).vertices,
    )
    text = """
    wind_speed = 8.0
    [sea]
    seed = 3
    [[sea.part]]
    seed = 1
    [[sea.part]]
    spectrum = "jonswap"
    hs = 1.0
    tp = 12.0
    """
    scenario = Scenario.from_config(tomllib.loads(text))
    assert scenario.surface.parts[0] == WIND_SEA
    assert scenario.surface.parts[1].hs == 1.0
    assert Scenario.from_config(tomllib.loads(scenario.to_toml())).surface == scenario.surface
    result = mt.simulate(scenario, photons=64, spacing=0.2)
    assert result.gain > 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SumSea(parts=[]), "parts"),
        (lambda: SumSea(parts=[FlatSea()]), r"parts.*flat.*random seas only"),
        (lambda: Scenario.from_config({"sea": {"part": 3}}), "sea.part: 3, allowed: tables"),
        (
            lambda: Scenario.from_config({"sea": {"part": [{}, {"omega_mx": 3.0}]}}),
            r"sea.part\[1\].omega_mx: 3.0, no such key",
        ),
    ],
)
def test_refuses_sums(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# ---- currents --------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [None, 3.0])
@pytest.mark.parametrize("capillary", [False, True])
def test_dispersion_in_a_current(depth, capillary):
    omega = np.geomspace(0.3, 3.0, 9)[:, None]
    theta = np.linspace(0.0, 2.0 * math.pi, 13)
    current = (0.5, -0.3)
    k = wavenumber_in_current(omega, theta, current, depth, capillary)
    along = current[0] * np.cos(theta) + current[1] * np.sin(theta)
    residual = angular_frequency(k, depth, capillary) + k * along - omega
    assert np.abs(residual / omega).max() < 1e-12
    assert (group_speed(k, depth, capillary) + along > 0.0).all()


def test_no_current_changes_no_bit():
    omega = np.geomspace(0.3, 30.0, 50)
    np.testing.assert_array_equal(wavenumber_in_current(omega, 0.3), wavenumber(omega))
    still = WIND_SEA.components
    np.testing.assert_array_equal(
        JonswapSea(wind_speed=8.0, seed=1, current=(0.0, 0.0)).components.omega, still.omega
    )


def test_an_opposing_current_stops_short_waves():
    # deep water: waves beyond g / (4 |U|) cannot run against a current
    limit = 9.81 / (4.0 * 0.5)
    wavenumber_in_current(0.999 * limit, math.pi, (0.5, 0.0))
    with pytest.raises(
        ValueError, match=r"current: .*wave of 4.9.* rad/s towards 180 deg can pass"
    ):
        wavenumber_in_current(1.001 * limit, math.pi, (0.5, 0.0))
    with pytest.raises(ValueError, match="current"):
        MeasuredSea(omega=[6.0], theta=[math.pi], variance=[[0.01]], current=(0.5, 0.0))


def test_a_spectrum_of_the_wind_is_carried_along():
    carried = JonswapSea(wind_speed=8.0, seed=1, current=(0.7, 0.2))
    drift = 3.0 * 0.7, 3.0 * 0.2
    np.testing.assert_allclose(
        carried.elevation(1.0 + drift[0], 2.0 + drift[1], 3.0),
        WIND_SEA.elevation(1.0, 2.0, 3.0),
        rtol=1e-10,
    )


def test_a_measured_spectrum_keeps_its_frequencies():
    sea = MeasuredSea(omega=[1.0, 2.0], theta=[0.0], variance=[[0.02], [0.005]], current=(1.0, 0.0))
    np.testing.assert_array_equal(sea.components.omega, [1.0, 2.0])
    assert (sea.components.kx < wavenumber([1.0, 2.0])).all()
