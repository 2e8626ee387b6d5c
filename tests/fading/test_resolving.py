"""The band that shows all fading: search, preset, refusals, warnings; heights of crests."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from mc_statistics import ALPHA, z_test
from typer.testing import CliRunner

import meshtrace as mt
from meshtrace import cli, fading
from meshtrace.errors import Refused
from meshtrace.results import load
from meshtrace.scenario import Scenario
from meshtrace.studies import FadingConvergence, fading_study
from meshtrace.surfaces import Elfouhaily, FlatSea, JonswapSea, SpectralSea, resolved_sea

SEA = SpectralSea(
    spectrum=Elfouhaily(wind_speed=5.0, fetch=30e3),
    spreading="elfouhaily",
    mss="elfouhaily",
)
NO_SCATTERING = mt.Link(water=mt.Water(a=0.114, b=0.0))


@cache
def band(radius=0.05):
    """Return the band of an aperture above SEA, searched once."""
    return fading.fading_band(mt.Link(receiver=mt.Receiver(radius=radius)), SEA)


def index(link, sea, omega_max, **options):
    return fading.scintillation_of_spectrum(link, sea, omega_max, **options)


@pytest.mark.parametrize("wind_speed", [3.0, 5.0])
def test_fading_is_the_smallest_band_within_three_per_cent(wind_speed):
    sea = resolved_sea(wind_speed, fetch=30e3)
    found = fading.resolve_band(mt.Link(), sea, "fading")
    assert 16.0 < found.omega_max < 36.0
    assert found == sea.model_copy(update={"omega_max": found.omega_max})
    whole = index(mt.Link(), sea, None)
    assert index(mt.Link(), sea, found.omega_max) == pytest.approx(whole, rel=0.0301)
    assert index(mt.Link(), sea, 0.95 * found.omega_max) < 0.97 * whole


def test_a_larger_aperture_needs_fewer_waves():
    assert band(radius=0.5) < 0.7 * band()


@pytest.mark.filterwarnings("ignore:receiver 0:meshtrace.engine.outcome.FewSamplesWarning")
@pytest.mark.thorough
def test_runs_store_the_number():
    link = mt.Link(receiver=mt.Receiver(radius=0.5))
    number = band(radius=0.5)
    run = mt.simulate(link, SEA, photons=32, spacing=0.5, waves="fading")
    assert run.provenance["surface"]["omega_max"] == number
    assert f"waves up to {number:.3g} rad/s" in run.summary()
    assert mt.simulate(Scenario.from_provenance(run.provenance)).gain == run.gain
    series = mt.time_series(link, SEA, [0.0], photons=32, mesh=mt.Meshing(spacing=0.5))
    assert series.provenance["surface"]["omega_max"] == number


def test_link_files():
    scenario = Scenario.from_toml('[sea]\nwaves = "fading"')
    assert (scenario.surface, scenario.meshing.waves) == (JonswapSea(), "fading")
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert scenario.case().surface == SEA.replace(omega_max=band())
    assert scenario.link.receivers == mt.Link().receivers
    calm = Scenario.from_toml('wind_speed = 0\n[sea]\nwaves = "fading"')
    assert isinstance(calm.case().surface, FlatSea)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[sea]\nomega_max = 'fading'", "sea.omega_max: 'fading', allowed: a number"),
        ("[sea]\nwaves = 'fade'", "sea.waves: 'fade', allowed: mean, paper, scaled"),
        ("[sea]\nwaves = -1.0", "sea.waves: -1.0, allowed: mean, paper, scaled, fading, a freq"),
    ],
)
def test_link_files_refuse(text, message):
    with pytest.raises(Refused) as refused:
        Scenario.from_toml(text)
    assert str(refused.value).startswith(message)


@pytest.mark.parametrize(
    "sea",
    [JonswapSea(gamma=7.0), SEA.replace(mss="band")],
    ids=["omega^-5 tail", "no slopes beyond"],
)
def test_runs_refuse(sea):
    with pytest.raises(Refused) as refused:
        mt.simulate(mt.Link(), sea, photons=32, waves="fading")
    assert refused.value.field == "waves"
    assert "\n" not in str(refused.value)


def test_no_band_follows_the_slopes_of_another_spectrum():
    sea = SEA.replace(mss="cox-munk", spectrum=Elfouhaily(wind_speed=8.0, fetch=30e3))
    with pytest.raises(Refused, match='waves: "fading" with mss = "cox-munk", which no band'):
        fading.fading_band(mt.Link(), sea)


@pytest.mark.parametrize("omega_max", [2.5, 4.0])
def test_heights_of_gentle_seas_are_the_linear_law(omega_max):
    """SI = int (beta k^2 + q)^2 S d omega, by a plain sum."""
    omega = np.linspace(0.6, omega_max, 4000)
    k = omega**2 / 9.81
    q = -0.114 + 0.66 / 16.65
    lens = (0.33 * 50.0 / 16.65 * k**2 + q) ** 2 * SEA.spectrum(omega)
    linear = np.trapezoid(lens, omega)
    found = index(NO_SCATTERING, SEA, omega_max, tilts=False, heights=True)
    assert found == pytest.approx(linear, rel=0.015)
    assert found < 0.9 * index(NO_SCATTERING, SEA, omega_max, tilts=False)


@pytest.mark.parametrize(
    ("omega_max", "measured", "stderr"), [(4.0, 0.0036, 0.0003), (8.0, 0.0840, 0.0045)]
)
def test_closed_form_with_heights_is_what_forced_detection_measured(omega_max, measured, stderr):
    """600 and 1200 seas of version 0.1, a = 0.114, b = 0, tilts beyond the band."""
    found = index(NO_SCATTERING, SEA, omega_max, heights=True)
    assert z_test(measured, stderr, found) > ALPHA


@pytest.mark.statistical
@pytest.mark.thorough
def test_ensemble_agrees_with_the_closed_form_and_warns():
    sea = JonswapSea(wind_speed=5.0, omega_max=4.11112)
    with pytest.warns(UserWarning, match="scintillation index of 0.0048, all waves 0.32") as caught:
        series = mt.ensemble(NO_SCATTERING, 150, sea, photons=32, seed=3)
    assert 'for fading use waves = "fading", here up to 19.7 rad/s' in str(caught[0].message)
    light = series.gain_ballistic
    measured = light.var(ddof=1) / light.mean() ** 2
    closed = series.provenance["closed_form"]
    assert closed["index_of_band"] == pytest.approx(
        index(NO_SCATTERING, sea, sea.band.omega_max, heights=True), rel=1e-9
    )
    # kurtosis of a nearly normal gain: relative error sqrt(2 / n)
    error = measured * math.sqrt(2.0 / 149.0)
    assert z_test(measured, error, closed["index_of_band"]) > ALPHA
    assert "closed form 0.00" in series.summary()
    assert "0.318 with all waves" in series.summary()


def test_no_warning_where_the_band_holds_the_fading():
    assert fading.band_fading(mt.Link(), SEA.model_copy(update={"omega_max": 24.0})).needed is None
    off_axis = mt.Link(receiver=mt.Receiver(position=(1.0, 0.0)))
    assert fading.band_fading(off_axis, JonswapSea()) is None
    assert fading.band_fading(mt.Link(), FlatSea()) is None


def test_study_of_the_fading(tmp_path):
    study = fading_study(mt.Link(), SEA, [4.0, 8.0, 16.0, 24.0])
    np.testing.assert_allclose(study.with_tilts, [0.00451, 0.09104, 0.30167, 0.31433], rtol=0.01)
    np.testing.assert_allclose(study.band_alone, [0.0046, 0.12419, 1.6238, 1.20066], rtol=0.01)
    assert study.all_waves == pytest.approx(0.32004, rel=0.01)
    assert study.recommended == band()
    assert np.isnan(study.measured).all()
    last = study.summary().splitlines()[-1]
    assert last.startswith("omega_max = 19.7 rad/s with tilts is within 3 %")
    study.save(tmp_path / "study.nc")
    again = load(tmp_path / "study.nc")
    assert isinstance(again, FadingConvergence)
    assert again.summary() == study.summary()


@pytest.mark.statistical
@pytest.mark.slow
def test_study_measures():
    link = mt.Link(water=NO_SCATTERING.water, receiver=mt.Receiver(height=1.0))
    study = fading_study(
        link,
        SEA,
        [2.0, 2.5, 3.0, 4.0],
        realizations=60,
        photons=32,
        seed=2,
        mesh=mt.Meshing(spacing=0.2),
    )
    assert (study.measured_stderr < 0.5 * study.measured).all()
    for i, omega_max in enumerate(study.omega_max):
        closed = index(link, SEA, omega_max, heights=True)
        assert z_test(study.measured[i], study.measured_stderr[i], closed) > ALPHA / 4


def test_command():
    invoke = CliRunner().invoke
    found = invoke(cli.app, ["converge", "--what", "fading", "--omega-max", "4,8,16,24"])
    assert found.exit_code == 0
    assert "with tilts is within 3 % of the scintillation index of all waves" in found.stdout
    for more, message in (
        (["--spacings", "1,2,3,4"], "--spacings"),
        (["--plot", "a.xyz"], "--plot"),
        (["--omega-max", "4,8"], "--omega-max"),
    ):
        refused = invoke(cli.app, ["converge", "--what", "fading", *more])
        assert refused.exit_code == 2
        assert refused.stderr.startswith(f"error: {message}")


def test_small_collectors_need_capillary_waves():
    lamp = mt.AirLed(height=1e6, half_angle_deg=60.0)
    disk = mt.WaterReceiver(depth=1.0, radius=0.0035, fov_deg=180.0)
    link, sea = mt.Link(transmitter=lamp, receiver=disk), resolved_sea(5.0)
    omega = fading.fading_band(link, sea)
    assert omega > 128.0
    indices = [fading.scintillation_of_spectrum(link, sea, o) for o in (omega, 2000.0, None)]
    assert indices[0] == pytest.approx(indices[2], rel=0.031)
    assert indices[1] == pytest.approx(indices[2], rel=1e-4)
