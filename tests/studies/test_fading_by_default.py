"""Studies of fading resolve a sea whose band was left open; means keep the band of mean gains."""

from __future__ import annotations

import warnings

import pytest
from mc_statistics import ALPHA, z_test

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.fading import resolve_band, scintillation_of_spectrum
from meshtrace.scenario import Scenario
from meshtrace.studies import background_series
from meshtrace.surfaces import (
    Elfouhaily,
    FlatSea,
    Jonswap,
    JonswapSea,
    PiersonMoskowitz,
    SinusoidalSea,
    SpectralSea,
    SumSea,
    Tma,
    resolved_sea,
)

WIDE = mt.Link(receiver=mt.Receiver(radius=0.5))
"""A link whose fading needs few waves, up to some 9 rad/s."""

FEW = {"photons": 64}
DAY = mt.Daylight.clear_sky(40.0, wavelength_nm=470.0)
HALF_ANGLE = {"transmitter.half_angle_deg": (5.0, 20.0)}

pytestmark = [
    pytest.mark.filterwarnings("ignore::meshtrace.engine.outcome.FewSamplesWarning"),
    pytest.mark.filterwarnings("ignore:waves:UserWarning"),
]


def resolved(wind_speed=5.0, link=WIDE):
    return resolve_band(link, resolved_sea(wind_speed, fetch=30e3), "fading")


def sea_of(found):
    """Return the sea in the provenance of a result."""
    origin = found.provenance
    return (origin.get("up") or origin)["surface"]


FADING = {
    "series": lambda link: mt.time_series(link, times=[0.0], **FEW),
    "ensemble": lambda link: mt.ensemble(link, 2, **FEW),
    "performance": lambda link: mt.link_performance(link, realizations=2, photons=64),
    "background": lambda link: background_series(link, None, DAY, [0.0], photons=32),
    "outage": lambda link: mt.optimize(
        link, bounds=HALF_ANGLE, realizations=2, method="bounded", **FEW
    ),
    "ber": lambda link: mt.sensitivities(link, None, ["water.a"], "ber", realizations=2, **FEW),
}
MEANS = {
    "simulate": lambda link: mt.simulate(link, **FEW),
    "one sea": lambda link: mt.sensitivities(link, None, ["water.a"], "ber", **FEW),
    "gain": lambda link: mt.sensitivities(link, None, ["water.a"], realizations=2, **FEW),
    "margin": lambda link: mt.optimize(
        link, bounds=HALF_ANGLE, objective="margin", realizations=2, method="bounded", **FEW
    ),
    "coverage": lambda link: mt.coverage_map(link, extent=1.0, step=1.0, **FEW),
}


@pytest.mark.parametrize("study", FADING)
def test_studies_of_fading_resolve_the_sea_of_the_wind(study):
    assert sea_of(FADING[study](WIDE)) == resolved().to_config()


@pytest.mark.parametrize("study", MEANS)
def test_means_keep_the_band_of_mean_gains(study):
    assert sea_of(MEANS[study](WIDE)) == JonswapSea().to_config()


def test_scenarios_resolve_as_links_do():
    for text in ("", "wind_speed = 8.0", "[sea]\nspectrum = 'jonswap'"):
        scenario = Scenario.from_toml(text + "\n[receiver]\nradius = 0.5")
        found = mt.ensemble(scenario, 2, **FEW)
        assert sea_of(found) == resolved(scenario.wind_speed).to_config()
        assert mt.simulate(scenario, **FEW).provenance["surface"]["kind"] == "jonswap"
        again = Scenario.from_provenance(found.provenance)
        assert mt.ensemble(again, 2, **FEW).gain == pytest.approx(found.gain, rel=1e-12)


def test_the_switch_of_a_link_file_serves_all_studies():
    narrow = Scenario.from_toml("[receiver]\nradius = 0.5\n[sea]\nwaves = 'mean'")
    assert narrow.surface.band == JonswapSea().band
    assert sea_of(mt.ensemble(narrow, 2, **FEW)) == narrow.surface.to_config()
    wide = Scenario.from_toml("[receiver]\nradius = 0.5\n[sea]\nwaves = 'fading'")
    assert sea_of(mt.simulate(wide, **FEW)) == resolved().to_config()
    short = Scenario.from_toml("[receiver]\nradius = 0.5\n[sea]\nwaves = 6.0")
    assert sea_of(mt.simulate(short, **FEW)) == JonswapSea(omega_max=6.0).to_config()
    for scenario in (narrow, wide, short):
        assert Scenario.from_toml(scenario.to_toml()) == scenario


@pytest.mark.thorough
def test_the_mesh_chooses_the_waves_of_any_study():
    for waves, sea in (
        ("mean", JonswapSea(waves="mean")),
        ("paper", JonswapSea(waves="paper")),
        ("fading", resolved()),
        (6.0, JonswapSea(omega_max=6.0)),
        (JonswapSea().band, JonswapSea(waves=JonswapSea().band)),
    ):
        found = mt.simulate(WIDE, JonswapSea(), waves=waves, **FEW)
        same = mt.simulate(WIDE, JonswapSea(waves="scaled"), mesh=mt.Meshing(waves=waves), **FEW)
        if waves != 6.0:  # a limit leaves the kind of the waves
            assert same.gain == found.gain
        assert found.gain == mt.simulate(WIDE, sea, **FEW).gain
        assert sea_of(found) == sea.to_config()
        assert found.provenance["run"]["waves"] is None


def test_waves_of_all_parts_of_a_sum():
    swell = SpectralSea(spectrum=Jonswap(hs=1.0, tp=12.0, gamma=6.0), mss="band")
    sea = SumSea(parts=[swell, JonswapSea()], seed=3)
    found = resolve_band(WIDE, sea, "scaled")
    assert [part.waves for part in found.parts] == ["scaled", "scaled"]
    assert resolve_band(WIDE, sea, "fading") == SumSea(parts=[swell, resolved()], seed=3)


@pytest.mark.parametrize("waves", ["fading", "paper", 6.0])
def test_waves_of_seas_without_a_spectrum(waves):
    assert resolve_band(WIDE, FlatSea(), waves) == FlatSea()
    wave = SinusoidalSea(amplitude=0.1, wavelength=2.0)
    assert resolve_band(WIDE, wave, "mean") is wave
    for sea in (wave, FlatSea().mesh(extent=5.0, spacing=1.0)):
        with pytest.raises(Refused, match=r"waves: .*, allowed: over a sea of a spectrum"):
            mt.simulate(WIDE, sea, waves=waves, **FEW)


@pytest.mark.parametrize(
    "sea",
    [
        JonswapSea(omega_max=4.0),
        JonswapSea(waves="mean"),
        JonswapSea(waves="scaled"),
        JonswapSea(waves="paper"),
        JonswapSea(mss="band"),
        JonswapSea(hs=1.0, tp=6.0),
        JonswapSea(gamma=7.0),
        JonswapSea(spreading="cos2s"),
        SpectralSea(spectrum=Tma(depth=10.0)),
        FlatSea(),
    ],
    ids=lambda sea: repr(sea)[:40],
)
def test_what_was_chosen_stays(sea):
    assert resolve_band(mt.Link(), sea, fading=True) is sea


@pytest.mark.parametrize(
    ("sea", "like"),
    [
        (JonswapSea(seed=4), resolved_sea(5.0, 30e3, seed=4)),
        (JonswapSea(wind_speed=8.0, fetch=50e3), resolved_sea(8.0, 50e3)),
        (JonswapSea(choppy=True), resolved_sea(5.0, 30e3).replace(choppy=True)),
        (SpectralSea(spectrum=PiersonMoskowitz(wind_speed=8.0)), resolved_sea(8.0)),
        (SpectralSea(spectrum=Elfouhaily(wind_speed=5.0)), resolved_sea(5.0)),
    ],
    ids=["seed", "wind", "choppy", "Pierson-Moskowitz", "Elfouhaily"],
)
def test_open_bands_are_those_of_the_resolved_sea(sea, like):
    assert resolve_band(mt.Link(), sea, fading=True) == resolve_band(mt.Link(), like, "fading")
    assert resolve_band(mt.Link(), sea, "fading") == resolve_band(mt.Link(), sea, fading=True)


def test_the_windiest_part_of_a_sum_is_resolved():
    swell = SpectralSea(spectrum=Jonswap(hs=1.0, tp=12.0, gamma=6.0), mss="band")
    found = resolve_band(WIDE, SumSea(parts=[swell, JonswapSea()], seed=3), fading=True)
    assert found == SumSea(parts=[swell, resolved()], seed=3)


def test_links_off_their_axis_have_the_band_of_the_axis():
    aside = WIDE.replace("receiver.position", (2.0, 1.0)).replace("receiver.tilt_deg", 10.0)
    several = WIDE.replace(receiver=(WIDE.receiver, mt.Receiver(height=8.0)))
    for link in (aside, several, WIDE.replace("receiver.fov_deg", 4.0)):
        assert resolve_band(link, JonswapSea(), fading=True) == resolved()


def test_a_lamp_close_to_the_surface_has_a_coarser_band():
    """At 1 m no band up to 128 rad/s has the index to 3 %; one below has it to 10 %."""
    link = mt.Link().at_depth(1.0)
    found = resolve_band(link, JonswapSea(), fading=True)
    sea = resolved_sea(5.0, 30e3)
    short = scintillation_of_spectrum(link, sea, found.omega_max)
    assert short == pytest.approx(0.9 * scintillation_of_spectrum(link, sea), rel=0.01)
    with pytest.raises(Refused, match="waves"):
        resolve_band(link, sea, "fading")


def test_links_without_random_slopes_keep_their_sea():
    """A band alone overshoots: 1.6 up to 16 rad/s, where all waves have 0.32."""
    bare = mt.Link(physics=mt.Physics(unresolved="none"))
    assert resolve_band(bare, JonswapSea(), fading=True) == JonswapSea()


def test_sources_and_places_without_a_closed_form_keep_their_sea():
    daylit = mt.Link(transmitter=mt.Sun(), receiver=mt.WaterAperture())
    for link in (daylit, mt.Link(receiver=())):
        with pytest.warns(UserWarning, match="the fading of short waves is left out"):
            assert resolve_band(link, JonswapSea(), fading=True) == JonswapSea()


@pytest.mark.parametrize(
    "sea", [JonswapSea(wind_speed=0.1), JonswapSea(wind_speed=20.0, fetch=1e3)]
)
def test_a_sea_without_a_band_for_fading_stays_with_a_warning(sea):
    with pytest.warns(UserWarning, match="the fading of short waves is left out"):
        assert resolve_band(mt.Link(), sea, fading=True) is sea


def test_both_directions_have_the_waves_of_the_uplink():
    """So its gains are those of a series; the downlink needs waves up to 11.9 rad/s, and says so."""
    with pytest.warns(UserWarning, match=r"^downlink: .* for its fading use waves = 11\.87$"):
        found = mt.duplex(WIDE, WIDE.mirrored(), JonswapSea(), realizations=2, **FEW)
    for origin in found.provenance:
        assert origin["surface"] == resolved().to_config()


def test_depths_share_the_band_of_the_first():
    found = mt.link_performance(WIDE, depths=[2.0, 10.0], realizations=2, photons=64)
    assert sea_of(found) == resolved(link=WIDE.at_depth(2.0)).to_config()


@pytest.mark.statistical
@pytest.mark.slow
def test_the_default_ensemble_has_the_scintillation_index_of_all_waves():
    """0.0047 before; error of an index of a law like the gamma, sqrt((2 + 10 SI) / n) SI."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = mt.ensemble(mt.Link(), 200, photons=256)
    light = found.gain_ballistic
    whole = scintillation_of_spectrum(mt.Link(), resolved_sea(5.0, 30e3), heights=True)
    error = whole * ((2.0 + 10.0 * whole) / 200) ** 0.5
    assert z_test(light.var(ddof=1) / light.mean() ** 2, error, whole) > ALPHA
