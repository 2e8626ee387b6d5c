"""Both estimators over choppy seas and seas of second order."""

from functools import cache

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.studies import convergence_study
from meshtrace.surfaces import JonswapSea, SinusoidalSea

CLEAR = mt.Link(water=mt.Water(a=0.114, b=0.0), physics=mt.Physics(unresolved="none"))
STEEP = SinusoidalSea(amplitude=0.1, wavelength=2.0, choppy=True, direction_deg=20.0, phase=0.4)


@cache
def unscattered(sea):
    return mt.simulate(CLEAR, sea, "forced", photons=512, seed=1).gain


@pytest.mark.parametrize("kind", [{"choppy": True}, {"order": 2}], ids=["choppy", "order-2"])
@pytest.mark.thorough_but("order-2")
def test_mean_gain_is_that_of_the_linear_sea(kind):
    ratios = []
    for seed in range(24):
        sea = JonswapSea(waves="paper", wind_speed=5.0, seed=seed)
        ratios.append(unscattered(sea.model_copy(update=kind)) / unscattered(sea))
    error = np.std(ratios, ddof=1) / np.sqrt(len(ratios))
    assert np.ptp(ratios) > 1e-4  # the crests differ
    assert error < 0.005
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.003 + 4.0 * error)


def test_crest_of_gerstners_wave_focuses_harder():
    """On the axis the gain is 1 / |1 + beta z''|, and less of the higher crest's distance."""
    link = CLEAR.model_copy(update={"receiver": mt.Receiver(radius=0.002)})
    beta = 0.33 * 5.0 * 10.0 / (10.0 + 1.33 * 5.0)
    flat = mt.simulate(link, SinusoidalSea(amplitude=0.0, wavelength=2.0), "forced", photons=512)
    for phase, sign in ((0.0, 1.0), (np.pi, -1.0)):  # crest and trough on the axis
        a, k = 0.02, np.pi
        wave = SinusoidalSea(amplitude=a, wavelength=2.0, choppy=True, phase=phase)
        curvature = sign * a * k**2 / (1.0 - sign * a * k) ** 2
        height = sign * a + 0.5 * a**2 * k
        spread = 1.0 - beta * curvature
        # lower by absorption and wider by distance, to first order in the height
        around = 1.0 + height * (2.0 * 0.33 / (10.0 + 1.33 * 5.0) - 0.114)
        gain = mt.simulate(link, wave, "forced", photons=512, mesh=mt.Meshing(spacing=0.01)).gain
        assert gain / flat.gain == pytest.approx(around / spread, rel=0.01)


@pytest.mark.thorough
def test_estimators_agree_over_a_steep_choppy_sea_without_leaks():
    link = mt.Link(
        transmitter=mt.Led(depth=5.0, half_angle_deg=10.0),
        receiver=mt.Receiver(height=5.0, radius=0.5),
        water=mt.Water(a=0.05, b=0.05),
        physics=mt.Physics(reflected="kill"),
    )
    forced = mt.simulate(link, STEEP, "forced", photons=4000, seed=1)
    analog = mt.simulate(link, STEEP, "analog", photons=100_000, seed=2)
    error = np.hypot(forced.gain_stderr, analog.gain_stderr)
    assert error < 0.04 * forced.gain
    assert forced.gain == pytest.approx(analog.gain, abs=4.0 * error)
    assert analog.fates["leaked"] == (0, 0.0)
    assert (analog.rays_recast, analog.rays_lost) == (0, 0)


@pytest.mark.parametrize("graded", [None, 1.0])
def test_light_from_beside_a_choppy_mesh_is_no_leak(graded):
    sea = JonswapSea(waves="paper", wind_speed=13.0, seed=3, choppy=True)
    mesh = sea.mesh(0.0, 4.0, 0.25, fine_extent=graded)
    link = mt.Link(
        water=mt.Water(a=0.02, b=0.5, phase=mt.HenyeyGreenstein(g=0.3)),
        transmitter=mt.Led(depth=2.0, half_angle_deg=60.0, position=(3.5, 0.0)),
    )
    with pytest.warns(mt.DomainWarning):
        result = mt.simulate(link, mesh, "analog", photons=40_000, seed=1)
    assert result.fates["leaked"] == (0, 0.0)
    assert (result.rays_recast, result.rays_lost) == (0, 0)
    assert result.fates["left_domain"].weight > 0.01


def test_provenance_rebuilds_the_sea():
    result = mt.simulate(CLEAR, STEEP, "forced", photons=512)
    assert mt.surfaces.sea_from_config(result.provenance["surface"]) == STEEP


def test_a_choppy_sea_is_no_reference_of_the_convergence_study():
    with pytest.raises(Refused, match=r"^reference: 'analytic for a choppy sea', allowed: None"):
        convergence_study(CLEAR, STEEP, [0.4, 0.2, 0.1, 0.05], reference="analytic")


def test_link_file(tmp_path):
    file = tmp_path / "link.toml"
    text = '[sea]\nspectrum = "jonswap"\nwind_speed = 5.0\nwaves = "paper"\n'
    for key, value in (("choppy", True), ("order", 2)):
        file.write_text(text + f"{key} = {str(value).lower()}\n")
        scenario = mt.Scenario.load(file)
        assert getattr(scenario.surface, key) == value
        assert mt.Scenario.from_config(scenario.to_config()).surface == scenario.surface
    file.write_text(text + "choppy = true\norder = 2\n")
    with pytest.raises(Refused, match=r"sea\.order: 2, allowed: 1 with choppy = true"):
        mt.Scenario.load(file)
