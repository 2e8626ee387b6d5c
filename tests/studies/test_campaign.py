"""One loop over links and surfaces: labels, common meshes, errors, bounds."""

import inspect

import numpy as np
import pytest
from mc_statistics import sidak, z_test

import meshtrace as mt
from meshtrace import fields
from meshtrace.engine.setup import ends
from meshtrace.engine.setup.options import RunOptions, StudyOptions
from meshtrace.errors import Refused
from meshtrace.results.tallies import error_of_groups
from meshtrace.studies import series
from meshtrace.studies.campaign import campaign_of
from meshtrace.surfaces import FlatSea, Jonswap, JonswapSea, SinusoidalSea, SpectralSea, SumSea

SEA = JonswapSea(wind_speed=13.0, seed=3, waves="paper")
WAVE = SinusoidalSea(amplitude=0.05, wavelength=3.0)
FEW = {"photons": 64, "seed": 5, "mesh": mt.Meshing(extent=4.0, spacing=0.2), "threads": 1}
LINKS = {"a": mt.Link(), "b": mt.Link().replace("water.b", 0.1)}


def test_the_wind_over_a_sum_of_seas_is_the_highest():
    flight, swell = mt.Flight(mt.Uav()), SpectralSea(spectrum=Jonswap(hs=1.0, tp=12.0))
    sea = SumSea(parts=[swell, JonswapSea(wind_speed=9.0)])
    assert campaign_of(mt.Link(), sea, run=FEW).wind_of(flight).wind_speed == 9.0
    with pytest.raises(Refused, match=r"flight\.wind: None, allowed: a wind, over a sea without"):
        campaign_of(mt.Link(), WAVE, run=FEW).wind_of(flight)


def test_gains_are_by_link_surface_receiver_and_shift():
    campaign = campaign_of(mt.Link(), SEA, run=FEW)._replace(links=LINKS)
    steps = campaign.realizations(3)
    found = campaign.gains(steps)
    assert found.shape == (2, 2, 3, 1, 32)
    alone = mt.ensemble(LINKS["a"], 3, SEA, **FEW)
    gain = found[0, 0, :, 0]
    np.testing.assert_array_equal(gain.mean(axis=-1), alone.gain)
    np.testing.assert_array_equal(error_of_groups(gain, -1), alone.gain_stderr)
    assert error_of_groups(gain.mean(axis=0)) == alone.mean_stderr
    first, second = (series.gain_series(campaign, steps, found, name) for name in LINKS)
    assert first.along == alone.along == "realization"
    np.testing.assert_array_equal(first.coordinate, steps.labels)
    np.testing.assert_array_equal(first.gain_ballistic, alone.gain_ballistic)
    assert first.provenance == alone.provenance
    assert second.provenance["link"]["water"]["b"] == 0.1


def test_links_have_one_mesh_for_each_surface(monkeypatch):
    made, seen = [], []

    def counted(kind):
        mesh = kind.mesh
        monkeypatch.setattr(
            kind, "mesh", lambda *a, **lines: made.append(lines) or mesh(*a, **lines)
        )

    counted(JonswapSea)
    counted(SinusoidalSea)
    mt.compare(LINKS, SEA, realizations=6, photons=64, threads=1, progress=seen.append)
    assert len(made) == 6
    assert seen == [1] * 12
    made.clear()
    mt.duplex(mt.Link(), mt.Link().mirrored(), WAVE, np.arange(3.0), **FEW)
    assert len(made) == 3
    made.clear()
    mt.compare({"a": LINKS["a"], "b": mt.Link().in_wind(10.0)}, photons=64, threads=1)
    assert len(made) == 2  # over seas of their own


def test_common_mesh_covers_links_apart():
    """Each link crosses within its own reach about its own place."""
    far = mt.Link().replace("receiver.position", (30.0, 0.0))
    far = far.replace("transmitter.position", (30.0, 0.0))
    campaign = campaign_of(mt.Link(), FlatSea(), run={"photons": 64})
    mesh = FlatSea().mesh(0.0, **campaign.lines([mt.Link(), far], FlatSea()))
    for link in (mt.Link(), far):
        own = FlatSea().mesh(0.0, **campaign.lines([link], FlatSea()))
        x = np.array(link.origin)[0]
        reach = ends.crossing_reach(link)
        assert mesh.bounds[0, 0] <= x - reach
        assert mesh.bounds[1, 0] >= x + reach
        assert own.bounds[1, 0] >= x + reach


def test_a_link_that_moves_is_alone_over_its_surface():
    campaign = campaign_of(mt.Link(), WAVE, run=FEW)
    times = np.array([0.0, 0.5])
    links = [mt.Link(), mt.Link().replace("receiver.tilt_deg", 10.0)]
    found = campaign.gains(campaign.in_time(times, [(link,) for link in links]))
    still = campaign.gains(campaign.in_time(times))
    assert found[1, 0, 0].mean() == still[1, 0, 0].mean()
    tilted = mt.simulate(links[1], WAVE, time=0.5, photons=64, extent=4.0, spacing=0.2)
    assert found[1, 0, 1].mean() == pytest.approx(tilted.gain_ballistic, rel=1e-12)


def test_errors_are_those_of_independent_samples():
    samples = np.random.default_rng(1).standard_normal((4, 32))
    expected = samples.std(axis=1, ddof=1) / np.sqrt(32.0)
    np.testing.assert_array_equal(error_of_groups(samples, -1), expected)


# ---- options of a run ------------------------------------------------------------------------

# with options of other meaning, or none, or those of `simulate`, over one surface
OWN = {"sweep", "sweep_file", "light_pattern", "swings", "steer", "pixel_signals"}


def functions():
    found = [getattr(mt.studies, name) for name in mt.studies.__all__]
    return [one for one in found if inspect.isfunction(one)]


@pytest.mark.parametrize("study", functions(), ids=lambda study: study.__name__)
def test_studies_name_surface_and_options_alike(study):
    given = inspect.signature(study).parameters
    assert not {"sea", "n_realizations", "uav", "wind"} & given.keys()
    if study.__name__ not in OWN:
        assert not {"seed", "threads", "store", "progress", "spacing", "time"} & given.keys()
        assert list(given)[-1] in ("run", "options")


@pytest.mark.parametrize("group", [mt.comms, mt.fading, mt.surfaces, mt.viz, mt.uav])
def test_other_functions_name_the_surface_alike(group):
    found = (getattr(group, name) for name in dir(group) if not name.startswith("_"))
    for function in filter(inspect.isfunction, found):
        assert "sea" not in inspect.signature(function).parameters, function.__name__


def test_every_option_of_a_run_is_documented():
    assert StudyOptions.__annotations__.keys() <= fields.entries(StudyOptions).keys()
    assert RunOptions.__annotations__.keys() < StudyOptions.__annotations__.keys()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fotons": 64}, "fotons: 64, no such key, did you mean photons"),
        ({"spacing": -0.5}, r"spacing: -0\.5, allowed: > 0"),
        ({"wave": "mean"}, "wave: 'mean', no such key, did you mean waves"),
        ({"mesh": 0.5}, "mesh: "),
        ({"rtol": 0.1}, "rtol: "),
        ({"progress": False}, "progress: [Ff]alse, allowed: a callable"),
    ],
)
def test_other_options_are_refused(options, message):
    with pytest.raises(Refused, match=message):
        mt.ensemble(mt.Link(), 2, SEA, **options)


def test_progress_of_a_map_is_a_function():
    with pytest.raises(Refused, match="progress: 5, allowed: a callable"):
        mt.coverage_map(mt.Link(), FlatSea(), photons=1000, progress=5)


def test_fields_of_the_meshing_are_options_as_in_simulate():
    sea, options = JonswapSea(wind_speed=5.0, seed=1), {"photons": 64, "threads": 1}
    short = mt.time_series(mt.Link(), sea, [0.0], waves="mean", normals="facet", **options)
    meshing = mt.Meshing(waves="mean", normals="facet")
    long = mt.time_series(mt.Link(), sea, [0.0], mesh=meshing, **options)
    assert short.gain == long.gain
    assert short.gain != mt.time_series(mt.Link(), sea, [0.0], **options).gain


def test_a_meshing_is_that_of_the_study():
    mesh = mt.Meshing(extent=4.0, spacing=0.2, normals="facet", time=1.5)
    found = mt.ensemble(mt.Link(), 1, SEA, photons=64, mesh=mesh)
    run = found.provenance["run"]
    assert [run[name] for name in ("extent", "spacing", "normals", "time")] == [
        4.0,
        0.2,
        "facet",
        1.5,
    ]


@pytest.mark.thorough
def test_individual_photons_give_the_gains_of_chains_over_each_sea():
    link = mt.Link(receiver=mt.Receiver(height=5.0, radius=1.0, fov_deg=180.0))
    sea, seas = JonswapSea(wind_speed=5.0, waves="mean"), 3
    run = mt.options.Run(estimator="analog", photons=65_536)
    scenario = mt.Scenario(wind_speed=5.0, link=link, surface=sea, run=run)
    analog, chains = mt.ensemble(scenario, seas), mt.ensemble(link, seas, sea, photons=2048)
    for i in range(seas):
        mine, other = (float(s.gain_stderr[i]) for s in (analog, chains))
        p = z_test(float(analog.gain[i]), mine, float(chains.gain[i]), other)
        assert p > sidak(1e-4, seas)
    assert analog.provenance["run"]["estimator"] == "analog"
    assert np.isnan(analog.gain_ballistic).all()
    assert mt.ensemble(scenario, seas, threads=1).gain.tolist() == analog.gain.tolist()


def test_the_printed_forms_have_an_error_rate():
    text = "physics = 'paper'\nwind_speed = 5.0\n[run]\nphotons = 65536\n"
    scenario = mt.Scenario.from_toml(text)
    found = mt.link_performance(scenario, realizations=2)
    assert found.provenance["run"]["estimator"] == "analog"
    # 100 mW at a gain of 1e-4 are far above what the receiver needs at 10 m
    assert found.at().margin_optical_db.value > 20.0
    with pytest.raises(Refused, match=r"run\.estimator: .analog., allowed: forced"):
        mt.optimize(scenario, bounds={"receiver.fov_deg": (10.0, 90.0)})
