"""Closed estimate of the light that the surface sends back, against analog photons."""

import math
import warnings

import numpy as np
import pytest
from scipy.stats import chi2

import meshtrace as mt
from meshtrace.engine import choice, outcome
from meshtrace.engine.forced import ForcedDetection
from meshtrace.errors import DomainWarning
from meshtrace.stored import SHIFTS
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

LOW, HIGH = 1.0 / 1.5, 3.0
"""Stated bounds of the closed estimate over the analog gain."""
BATCHES = 8


def link_of(*, a=0.1, b=0.5, g=0.0, depth=10.0, half=60.0, reflected="trace", **receiver):
    return mt.Link(
        water=mt.Water(a=a, b=b, phase=mt.HenyeyGreenstein(g=g)),
        transmitter=mt.Led(depth=depth, half_angle_deg=half),
        receiver=mt.Receiver(**{"radius": 1.0, "fov_deg": 179.0, **receiver}),
        physics=mt.Physics(reflected=reflected),
    )


def returned_by_analog(surface, photons, **options):
    """Return the gain and error of what `reflected="trace"` adds to the same photons."""
    gain = []
    for batch in range(BATCHES):
        on, off = (
            mt.simulate(
                link_of(**options, reflected=word), surface, "analog",
                photons=photons, first_photon=batch * photons, seed=2,
            ).gain
            for word in ("trace", "kill")
        )  # fmt: skip
        gain.append(on - off)
    return np.mean(gain), np.std(gain, ddof=1) / math.sqrt(BATCHES)


FLAT = FlatSea()
WAVES = JonswapSea(wind_speed=8.0, seed=1)
SHALLOW = {
    "isotropic, 3 m": (FLAT, 30_000, {"depth": 3.0}),
    "backward, 3 m": (FLAT, 30_000, {"depth": 3.0, "g": -0.5}),
}
DEEP = {
    "isotropic, 10 m": (FLAT, 200_000, {}),
    "backward, clear, 10 m": (FLAT, 200_000, {"b": 0.05, "g": -0.5}),
    "isotropic, 10 m, waves": (WAVES, 200_000, {}),
    "backward, clear, 10 m, waves": (WAVES, 200_000, {"b": 0.05, "g": -0.5}),
}


def check(surface, photons, options):
    """3.9 standard errors: a right estimate fails one test in 10^4."""
    gain, error = returned_by_analog(surface, photons, **options)
    closed = choice.returned_gain(link_of(**options))[0]
    print(f"analog {gain:.3e} +- {error:.1e}, closed / analog {closed / gain:.2f}")
    assert gain > 4.0 * error
    assert LOW * (gain - 3.9 * error) < closed < HIGH * (gain + 3.9 * error)


@pytest.mark.statistical
@pytest.mark.parametrize("name", SHALLOW)
def test_closed_estimate_of_shallow_lamps(name):
    check(*SHALLOW[name])


@pytest.mark.slow
@pytest.mark.statistical
@pytest.mark.parametrize("name", DEEP)
def test_closed_estimate_of_deep_lamps(name):
    check(*DEEP[name])


def test_the_warning_names_the_share_and_the_remedy():
    once = mt.simulate(link_of(depth=3.0, reflected="kill"), FLAT, photons=2048, seed=1)
    with pytest.warns(DomainWarning, match=r"about [78] % .*estimator=.analog. follows it"):
        outcome.warn_of_omitted(link_of(depth=3.0), once.gains)


def test_nothing_returns_where_it_is_ended_or_not_scattered():
    assert choice.returned_gain(link_of(reflected="kill"))[0] == 0.0
    assert choice.returned_gain(link_of(b=0.0))[0] == 0.0


def test_the_estimate_does_not_depend_on_the_unit_of_length():
    link, k = link_of(), 1e-2
    small = link_of(a=0.1 / k, b=0.5 / k, depth=10.0 * k, radius=k, height=5.0 * k)
    np.testing.assert_allclose(choice.returned_gain(small), choice.returned_gain(link), rtol=1e-12)


def test_water_between_layers_is_interpolated():
    link, sloped = link_of(a=0.15, b=0.75), ((0.0, 0.1, 0.5), (10.0, 0.2, 1.0))
    layered = link.replace(water=mt.Water(layers=sloped, phase=link.water.phase))
    np.testing.assert_allclose(
        choice.returned_gain(layered), choice.returned_gain(link), rtol=1e-12
    )


def test_layers_of_one_water_are_that_water():
    link = link_of()
    rows = tuple((z, 0.1, 0.5) for z in (0.0, 2.0, 20.0))
    water = mt.Water(layers=rows, phase=mt.HenyeyGreenstein(g=0.0))
    layered = link.replace(water=water)
    np.testing.assert_allclose(
        choice.returned_gain(layered), choice.returned_gain(link), rtol=1e-12
    )


def test_rays_that_go_down_do_not_count():
    """Half of the light of an isotropic source: a finite estimate, less than that of a lamp."""
    receiver = mt.Receiver(height=1.0, fov_deg=179.0)
    around, upwards = (
        choice.returned_gain(mt.Link(transmitter=t, receiver=receiver))
        for t in (mt.IsotropicSource(depth=5.0), mt.Led(depth=5.0))
    )
    assert 0.0 < around[0] < upwards[0]


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"estimator": "forced", "photons": 32, "rtol": 0.02}, ["cuts off 2."]),
        ({"estimator": "analog", "photons": 1000, "rtol": 0.05}, ["left the meshed surface"]),
    ],
)
def test_a_run_to_a_tolerance_warns_once(options, found):
    """Each of its repetitions once warned, by its own gain."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = mt.simulate(link_of(depth=3.0), FLAT, seed=1, extent=3.0, **options)
    assert run.photons > options["photons"]
    assert len(caught) == len(found)
    for warning, text in zip(caught, found, strict=True):
        assert text in str(warning.message)
        assert warning.filename == __file__


def test_the_share_of_returned_light_is_at_most_all(monkeypatch):
    monkeypatch.setattr("meshtrace.engine.outcome.returned_gain", lambda link: np.array([1e-9]))
    for gain, percent in ((1e-129, "100"), (1e-9, "50"), (1e-7, "1")):
        with pytest.warns(mt.DomainWarning, match=f"about {percent} % of the light leaves"):
            outcome.warn_of_omitted(mt.Link(), np.array([gain]))


TURBID = mt.Link(water=mt.Water(a=0.1, b=1.0))
"""0.06 % of its light is reflected first."""


@pytest.mark.thorough
def test_little_light_that_is_reflected_first_has_few_photons():
    """They took nine tenths of the time of a link in turbid water, for a thousandth of its light."""
    found = ForcedDetection(TURBID, 4096, 1)
    assert set(found.method) == {"chains"}
    assert SHIFTS <= found.plan.joined.photons < 0.2 * 4096


@pytest.mark.statistical
@pytest.mark.slow
def test_the_error_with_few_photons_is_that_of_the_scatter():
    """Chi-square of 64 seeds about their mean, 63 degrees of freedom."""
    runs = [mt.simulate(TURBID, FlatSea(), photons=4096, seed=s) for s in range(64)]
    gain, error = (np.array([getattr(r, n) for r in runs]) for n in ("gain", "gain_stderr"))
    square = ((gain - gain.mean()) ** 2).sum() / np.mean(error**2)
    assert chi2.ppf(5e-4, 63) < square < chi2.ppf(1.0 - 5e-4, 63)
