"""Options of a run: one definition for Python, link files and results."""

import inspect
import json

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.setup.options import Run, read_records, resolve
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea, JonswapSea

FEW = {"photons": 300, "threads": 1}


def test_simulate_has_twelve_parameters_and_no_options_of_one_estimator():
    parameters = inspect.signature(mt.simulate).parameters.values()
    assert len([p for p in parameters if p.kind is not p.VAR_KEYWORD]) <= 12
    assert "Analog only" not in (mt.simulate.__doc__ or "")


def test_options_of_an_estimator_stand_beside_the_others_in_plain_data():
    run = Run(estimator=mt.Analog(roulette=0.1), photons=500)
    config = json.loads(json.dumps(run.to_config()))
    assert (config["estimator"], config["roulette"], config["photons"]) == ("analog", 0.1, 500)
    assert Run(**config) == run
    assert Run.model_validate_json(run.model_dump_json()) == run


def test_photons_follow_the_estimator_unless_given():
    assert Run().photons == mt.Forced.default_photons
    assert Run().replace(estimator="analog").photons == mt.Analog.default_photons
    assert Run(photons=70).replace(estimator="analog").photons == 70


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"photons": 0}, "photons: 0, allowed: 1 <= photons"),
        ({"photons": 1.5}, "photons: 1.5, allowed: an integer"),
        ({"photons": 31}, "photons: 31, allowed: an integer >= 32 for forced detection"),
        ({"seed": -1}, "seed: -1, allowed: 0 <= seed"),
        ({"rtol": 2.0}, "rtol: 2.0, allowed: 1e-06 <= rtol <= 1"),
        ({"threads": 0}, "threads: 0, allowed: 1 <= threads <= 1024"),
        ({"normals": "corner"}, "normals: 'corner', allowed: vertex or facet"),
        ({"time": float("nan")}, "time: nan, allowed: finite numbers"),
        ({"spacing": 0.0}, "spacing: 0.0, allowed: > 0"),
        ({"mesh": mt.Meshing(), "extent": -1.0}, "extent: -1.0, allowed: > 0"),
        ({"estimator": "force"}, "estimator: 'force', did you mean forced? allowed: forced, "),
        ({"estimator": 3}, "estimator: 3, allowed: "),
        ({"roulette": 0.1}, 'roulette: 0.1, allowed: only with estimator = "analog"'),
        ({"estimator": "analog", "batch_size": 5000}, "batch_size: 5000, allowed: a multiple"),
        ({"estimator": "analog", "roulete": 0.1}, "roulete: 0.1, no such key, did you mean roul"),
        ({"record": ["arrival"]}, "record[0].kind: 'arrival', did you mean arrivals?"),
        ({"record": ["arrivals", mt.Arrivals()]}, "record[1]: 'arrivals', allowed: one record"),
        (
            {"record": [mt.IrradianceMap(height=5.0, extent=1.0, step=0.5)]},
            "record[0]: 'irradiance-map', allowed: arri",
        ),
    ],
)
def test_wrong_options_are_refused_by_name(options, line):
    with pytest.raises(Refused) as caught:
        mt.simulate(mt.Link(), FlatSea(), **options)
    assert str(caught.value).startswith(line)


def test_maps_need_some_cells():
    with pytest.raises(Refused, match=r"^step: 3.0, allowed: 1 to 10000 cells"):
        mt.IrradianceMap(height=5.0, extent=1.0, step=3.0)
    grid = mt.IrradianceMap(height=5.0, extent=1.0, step=0.5)
    assert (grid.n, grid) == (4, mt.IrradianceMap(height=5.0, extent=1.0, step=0.5))
    assert read_records([grid.model_dump()], mt.Analog()) == {"irradiance-map": grid}


def test_keywords_and_models_say_the_same():
    sea = JonswapSea(wind_speed=5.0, seed=2, waves="paper")
    mesh = mt.Meshing(time=1.0, spacing=0.5, normals="facet")
    a = mt.simulate(mt.Link(), sea, mesh=mesh, seed=3, **FEW)
    b = mt.simulate(mt.Link(), sea, time=1.0, spacing=0.5, normals="facet", seed=3, **FEW)
    assert (a.gain, a.provenance) == (b.gain, b.provenance)
    c = mt.simulate(mt.Link(), sea, "analog", roulette=0.0, max_events=50, **FEW)
    d = mt.simulate(mt.Link(), sea, mt.Analog(roulette=0.0, max_events=50), **FEW)
    assert (c.fates, c.provenance) == (d.fates, d.provenance)


def test_a_scenario_stands_for_link_sea_and_options():
    text = "wind_speed = 8.0\n[sea]\nspacing = 0.5\n[run]\nseed = 5\nphotons = 300\nthreads = 1"
    scenario = mt.Scenario.from_toml(text)
    case = resolve(scenario)
    assert (case.run.seed, case.meshing.spacing, case.surface) == (5, 0.5, scenario.surface)
    whole = mt.simulate(scenario)
    assert whole.gain == scenario.simulate().gain
    direct = mt.simulate(scenario.link, scenario.surface, seed=5, spacing=0.5, **FEW)
    assert (whole.gain, whole.provenance) == (direct.gain, direct.provenance)
    assert mt.simulate(scenario, seed=6).provenance["run"]["seed"] == 6
    assert mt.simulate(scenario, FlatSea()).provenance["surface"]["kind"] == "flat"


@pytest.mark.parametrize(
    ("wind_speed", "kind"), [(None, "jonswap"), (0.0, "jonswap"), (9.0, "jonswap")]
)
def test_the_default_sea_follows_the_wind_of_the_link(wind_speed, kind):
    link = mt.Link() if wind_speed is None else mt.Link().in_wind(wind_speed)
    surface = resolve(link).surface
    assert (surface.kind, surface.wind_speed) == (kind, wind_speed or 5.0)


@pytest.mark.parametrize("wrong", [(3, None), (mt.Link(), "sea")])
def test_other_objects_are_refused(wrong):
    with pytest.raises(Refused, match=r"^(link: 3|surface: 'sea'), allowed: "):
        mt.simulate(*wrong)


def test_a_run_of_the_version_before_gives_a_scenario():
    before = {
        "estimator": "forced", "photons": 300, "rtol": None, "seed": 4, "normals": "facet",
        "time": 1.5, "extent": None, "spacing": 0.5, "threads": 2,
        "batch_size": 131072, "first_photon": 0, "max_surface_events": 10,
        "max_events": 100000, "roulette": None, "grid": None, "keep_arrivals": False,
    }  # fmt: skip
    origin = {"link": mt.Link().model_dump(mode="json"), "surface": FlatSea().to_config()}
    scenario = mt.Scenario.from_provenance({**origin, "run": before})
    assert scenario.run == Run(photons=300, seed=4)
    assert scenario.meshing == mt.Meshing(time=1.5, spacing=0.5, normals="facet")


def test_records_are_kept_by_both_estimators():
    for estimator in ("forced", "analog"):
        link = mt.Link(receiver=mt.Receiver(radius=2.0))
        r = mt.simulate(link, FlatSea(), estimator, record=[mt.Arrivals()], **FEW)
        assert r.arrivals.weight.sum() == pytest.approx(r.gain, rel=1e-9)
        assert r.provenance["run"]["record"] == [{"kind": "arrivals"}]
    grid = mt.IrradianceMap(height=5.0, extent=3.0, step=0.5)
    r = mt.simulate(mt.Link(), FlatSea(), "analog", photons=5000, threads=1, record=[grid])
    assert r.map.irradiance.shape == (12, 12)
    assert np.isfinite(r.map.irradiance).all()
