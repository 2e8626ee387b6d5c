"""Studies at several wavelengths with common paths."""

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.daylight import Daylight
from meshtrace.errors import Refused
from meshtrace.results import impulse_response, load
from meshtrace.studies import coverage, link_performance
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = [
    pytest.mark.filterwarnings("ignore::meshtrace.DaylightWarning"),
    pytest.mark.filterwarnings("ignore:.*effective sample size:meshtrace.FewSamplesWarning"),
    pytest.mark.filterwarnings("ignore:the band of waves"),
    pytest.mark.filterwarnings("ignore:.*left the meshed surface sideways"),
]

LINK = mt.Link(water=mt.Water.from_type("jerlov-IB"))
SEA = JonswapSea(wind_speed=5.0, seed=2)
MESH = mt.Meshing(spacing=0.3, waves="mean")
AT = [450.0, 500.0, 550.0]


def test_an_ensemble_has_common_paths(tmp_path):
    kw = {"photons": 1024, "mesh": MESH}
    found = mt.ensemble(LINK, 4, SEA, wavelengths_nm=AT, **kw)
    assert found["gain"].dims == ("wavelength", "realization")
    for nm, series in found:
        alone = mt.ensemble(LINK.at_wavelength(nm), 4, SEA, seed=1, **kw)
        assert (series.coordinate == alone.coordinate).all()
        again = mt.ensemble(LINK.at_wavelength(nm), 4, SEA, **kw)
        assert (again.gain == alone.gain).all()
        error = np.hypot(series.gain_stderr, alone.gain_stderr)
        assert (abs(series.gain - alone.gain) < 4.0 * error).all()
    found.save(tmp_path / "ensemble.nc")
    kept = load(tmp_path / "ensemble.nc")
    assert kept.at_wavelength(500.0).summary() == found.at_wavelength(500.0).summary()


@pytest.mark.thorough
def test_depths_and_wavelengths_share_a_store(tmp_path):
    """Once the loops of all depths and wavelengths had one name, and the second was refused."""
    options = {"photons": 64, "realizations": 2, "daylight": Daylight.night()}
    options |= {"depths": [8.0, 10.0], "wavelengths_nm": AT[:2]}
    stored = [link_performance(LINK, FlatSea(), store=tmp_path / "a", **options) for _ in range(2)]
    expected = link_performance(LINK, FlatSea(), **options).summary()
    assert [performance.summary() for performance in stored] == [expected, expected]


def test_a_flight_tilts_the_receiver_at_all_wavelengths():
    flight = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=13.0))
    kw = {"photons": 256, "wavelengths_nm": AT, "mesh": MESH}
    level = mt.time_series(LINK, SEA, [0.0, 0.1], **kw)
    flown = mt.time_series(LINK, SEA, [0.0, 0.1], flight=flight, **kw)
    assert flown["gain"].shape == (3, 2)
    assert (flown["gain"] < level["gain"]).all()


def test_workers_and_threads_do_not_change_a_bit():
    kw = {"photons": 256, "wavelengths_nm": AT, "mesh": MESH}
    one, two = (mt.ensemble(LINK, 3, SEA, threads=n, **kw) for n in (1, 2))
    assert one["gain"].equals(two["gain"])


def test_the_background_has_the_light_of_each_wavelength():
    day = Daylight.night()
    found = mt.background(LINK, FlatSea(), day, photons=256, wavelengths_nm=AT)
    assert found["background_radiance"].dims == ("wavelength",)
    for nm, one in found:
        alone = mt.background(LINK.at_wavelength(nm), FlatSea(), day.at_wavelength(nm), photons=256)
        assert one.radiance == pytest.approx(alone.radiance, rel=1e-4)
        assert one.wavelength_nm == nm
    given = Daylight(direct=1.0, diffuse=0.1)
    with pytest.raises(Refused, match="a model of"):
        mt.background(LINK, FlatSea(), given, photons=256, wavelengths_nm=AT)


def of_chlorophyll(content, **parts):
    spectrum = mt.optics.Constituents(chlorophyll=content)
    return mt.Link(water=mt.Water(spectrum=spectrum, wavelength_nm=550.0), **parts)


LAYERS = of_chlorophyll([(0, 0.2), (5, 1.0), (20, 0.3)], bubbles=mt.HallNovarini(wind_speed=8.0))
WATERS = {
    "II": mt.Link(water=mt.Water.from_type("jerlov-II", 550.0)),
    "3C": mt.Link(water=mt.Water.from_type("jerlov-3C", 550.0)),
    "chlorophyll": of_chlorophyll(0.5),
    "layers": LAYERS,
}
COLOURS = [400.0, 480.0, 570.0]


@pytest.mark.parametrize("sea", [FlatSea(), SEA], ids=["smooth", "rough"])
@pytest.mark.parametrize("water", WATERS)
@pytest.mark.thorough_but(*(f"{name}-rough" for name in WATERS))
@pytest.mark.slow_but(*(f"{name}-rough" for name in WATERS), "II-smooth", "layers-smooth")
def test_rays_of_the_background_are_common_to_all_wavelengths(water, sea):
    """The same rays as alone: no noise is left, but what is linear in the index."""
    pytest.importorskip("pvlib")
    link, day = WATERS[water], Daylight.clear_sky(30.0, wavelength_nm=550.0)
    found = mt.background(link, sea, day, photons=1024, wavelengths_nm=COLOURS)
    for nm, one in found:
        alone = mt.background(link.at_wavelength(nm), sea, day.at_wavelength(nm), photons=1024)
        assert one.part_radiance == pytest.approx(alone.part_radiance, rel=2e-4)
        assert one.part_radiance_stderr == pytest.approx(alone.part_radiance_stderr, rel=1e-2)


@pytest.mark.parametrize("way", ["walk", "down"])
@pytest.mark.parametrize("water", WATERS)
@pytest.mark.thorough
@pytest.mark.slow_but("3C-walk", "layers-down")
def test_walks_in_the_water_bring_the_light_of_all_wavelengths(water, way):
    pytest.importorskip("pvlib")
    link = WATERS[water] if way == "walk" else WATERS[water].mirrored()
    kw = {"photons": 16_384, "water": "walk", "threads": 2}
    day = Daylight.clear_sky(30.0, wavelength_nm=550.0)
    found = mt.background(link, SEA, day, wavelengths_nm=COLOURS, **kw)
    for nm, one in found:
        alone = mt.background(link.at_wavelength(nm), SEA, day.at_wavelength(nm), seed=99, **kw)
        a, b = ((x.radiance, x.radiance_stderr) for x in (one, alone))
        assert z_test(*a, *b) > sidak(ALPHA, 24)
        assert a[1] < 4.0 * b[1]


@pytest.mark.slow
@pytest.mark.parametrize("way", ["walk", "down"])
def test_errors_of_the_background_are_true_at_all_wavelengths(way):
    """Scatter over 64 seeds against the stated errors, and the mean against that of own runs."""
    pytest.importorskip("pvlib")
    link = WATERS["3C"] if way == "walk" else WATERS["3C"].mirrored()
    day = Daylight.clear_sky(30.0, wavelength_nm=550.0)
    kw = {"photons": 2048, "water": "walk", "threads": 2}
    runs = [
        mt.background(link, SEA, day, wavelengths_nm=COLOURS, seed=seed, **kw) for seed in range(64)
    ]
    for nm in COLOURS:
        lit = [run.at_wavelength(nm) for run in runs]
        values, errors = (np.array([getattr(x, name) for x in lit]) for name in
                          ("radiance", "radiance_stderr"))  # fmt: skip
        chi2 = ((values - values.mean()) ** 2).sum() / (errors**2).mean()
        assert 35.0 < chi2 < 105.0
        alone = [
            mt.background(link.at_wavelength(nm), SEA, day.at_wavelength(nm), seed=100 + s, **kw)
            for s in range(64)
        ]
        other = np.array([x.radiance for x in alone])
        means = [(v.mean(), v.std(ddof=1) / 8.0) for v in (values, other)]
        assert z_test(*means[0], *means[1]) > sidak(ALPHA, 6)


@pytest.mark.parametrize(
    "day",
    [Daylight.clear_sky(40.0, aerosol=0.2), Daylight.overcast(), Daylight.moon(20.0)],
    ids=lambda day: day.light,
)
def test_daylight_at_another_wavelength_is_that_of_its_model(day):
    pytest.importorskip("pvlib")
    other = day.at_wavelength(550.0)
    assert other.wavelength_nm == 550.0
    assert other.at_wavelength(470.0) == day
    assert other.irradiance != day.irradiance


@pytest.mark.thorough
def test_performance_by_wavelength(tmp_path):
    kw = {"photons": 512, "realizations": 4, "depths": [10.0, 12.0], "bit_rate": 1e6, "mesh": MESH}
    found = link_performance(LINK, SEA, wavelengths_nm=AT, **kw)
    assert found["ber"].dims == ("wavelength", "depth", "bit_rate")
    for k, (nm, one) in enumerate(found):
        alone = link_performance(LINK.at_wavelength(nm), SEA, seed=20 + k, **kw)
        for depth in kw["depths"]:
            a, b = (found.at(depth).gain for found in (one, alone))
            widths = [(g.high - g.low) / 3.92 for g in (a, b)]
            assert z_test(a.value, widths[0], b.value, widths[1]) > sidak(ALPHA, 6)
    found.save(tmp_path / "performance.nc")
    kept = load(tmp_path / "performance.nc")
    assert kept.at_wavelength(500.0).summary() == found.at_wavelength(500.0).summary()


SEAS = {"flat": FlatSea(), "wavy": JonswapSea(wind_speed=5.0, seed=2, waves="paper")}


@pytest.mark.parametrize("rtol", [None, 0.05], ids=["photons", "image"])
@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.parametrize("water", ["jerlov-II", "jerlov-3C"])
@pytest.mark.thorough
@pytest.mark.slow_but("jerlov-II-wavy-image", "jerlov-II-flat-photons")
def test_maps_of_common_photons_are_those_of_direct_runs(water, sea, rtol):
    """Sums of the cells, by the normal distribution; no cell beyond 4.5 of its errors."""
    link = mt.Link(water=mt.Water.from_type(water))
    kw = {"extent": 1.0, "step": 0.5, "photons": 200_000, "rtol": rtol}
    found = mt.coverage_map(link, SEAS[sea], wavelengths_nm=[450.0, 500.0, 560.0], **kw)
    assert found["gain"].dims == ("wavelength", "x", "y")
    for nm, one in found:
        alone = mt.coverage_map(link.at_wavelength(nm), SEAS[sea], seed=7, **kw)
        assert one.provenance["unscattered"] == alone.provenance["unscattered"]
        error = np.hypot(one.gain_stderr, alone.gain_stderr)
        assert abs((one.gain - alone.gain) / error).max() < 4.5
        sums = [(m.gain.sum(), np.linalg.norm(m.gain_stderr)) for m in (one, alone)]
        assert z_test(*sums[0], *sums[1]) > sidak(ALPHA, 24)
        if rtol is not None:
            assert (one.gain_stderr <= rtol * one.gain).all()


def test_the_image_between_two_indices_is_that_of_its_index():
    """Clear water at 400, 500 and 700 nm: 0.1 % of the highest gain beside the errors."""
    link = mt.Link(water=mt.Water.from_type("jerlov-I"))
    kw = {"extent": 0.5, "step": 0.5, "photons": 4096, "rtol": 1.0}
    at = [400.0, 500.0, 700.0]
    found = mt.coverage_map(link, FlatSea(), wavelengths_nm=at, **kw).at_wavelength(500.0)
    alone = mt.coverage_map(link.at_wavelength(500.0), FlatSea(), **kw)
    error = 4.0 * np.hypot(found.gain_stderr, alone.gain_stderr) + 1e-3 * alone.gain.max()
    assert (abs(found.gain - alone.gain) < error).all()


def test_maps_do_not_depend_on_threads_and_are_kept(tmp_path):
    kw = {"extent": 1.0, "step": 1.0, "photons": 20_000, "wavelengths_nm": AT}
    one, two = (mt.coverage_map(LINK, FlatSea(), threads=n, **kw) for n in (1, 2))
    assert one["gain"].equals(two["gain"])
    for _ in range(2):
        kept = mt.coverage_map(LINK, FlatSea(), store=tmp_path / "map.store", **kw)
        assert kept["gain"].equals(one["gain"])
    one.save(tmp_path / "map.nc")
    again = load(tmp_path / "map.nc")
    assert again.at_wavelength(500.0).summary() == one.at_wavelength(500.0).summary()
    assert again.brightest == one.brightest


@pytest.mark.slow
def test_far_wavelengths_have_photons_of_their_own(monkeypatch):
    """Few photons of 400 nm carry light of 700 nm: less than half as many as that of their own.

    Below bubbles, where photons are those of one base.
    """
    monkeypatch.setattr(coverage, "FEW_PHOTONS", np.inf)
    link = mt.Link(
        transmitter=mt.Led(depth=20.0), water=mt.Water.from_type("jerlov-II"),
        bubbles=mt.HallNovarini(wind_speed=3.0),
    )  # fmt: skip
    kw = {"extent": 1.0, "step": 1.0, "photons": 50_000}
    found = mt.coverage_map(link, FlatSea(), wavelengths_nm=[400.0, 700.0], **kw)
    alone = mt.coverage_map(link.at_wavelength(700.0), FlatSea(), **kw)
    assert (found.at_wavelength(700.0).gain == alone.gain).all()


def test_errors_of_deep_maps_keep_their_digits():
    """Squares of weights of e^-20 lie below the unit of the integer sums."""
    link = mt.Link(transmitter=mt.Led(depth=20.0), water=mt.Water(a=1.0, b=0.0))
    found = mt.coverage_map(link, FlatSea(), 2.0, 4.0, photons=20_000)
    weight = np.exp(-20.0) * np.pi * mt.Receiver().radius ** 2 / 16.0
    photons = 20_000 * found.gain / weight
    assert (found.gain_stderr > 0.5 * found.gain / np.sqrt(photons)).all()


def test_arrivals_of_common_paths_are_those_of_each_wavelength():
    kw = {"photons": 4096, "record": [mt.Arrivals()]}
    for nm, one in mt.simulate(LINK, SEA, wavelengths_nm=AT, **kw):
        assert one.arrivals.weight.sum() == pytest.approx(one.gain, rel=1e-5)
        alone = mt.simulate(LINK.at_wavelength(nm), SEA, seed=5, **kw)
        a, b = (impulse_response(r) for r in (one, alone))
        p = z_test(a.mean_delay, a.mean_delay_stderr, b.mean_delay, b.mean_delay_stderr)
        assert p > sidak(ALPHA, 3)
    kw = {"photons": 20_000, "record": [mt.Arrivals()]}
    for _, one in mt.simulate(LINK, FlatSea(), "analog", wavelengths_nm=AT, **kw):
        assert one.arrivals.weight.sum() == pytest.approx(one.gain, rel=1e-12)
