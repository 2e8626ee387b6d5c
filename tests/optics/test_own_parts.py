"""A user's own phase function and bubble population: used, written, read back, refused."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.optics import phase
from meshtrace.surfaces import FlatSea


class TwinOfHenyeyGreenstein(mt.PhaseFunction):
    g: float = 0.9

    def density(self, theta):
        return 7.0 * (1.0 + self.g**2 - 2.0 * self.g * np.cos(theta)) ** -1.5


class TwinOfFournierForand(mt.PhaseFunction):
    def density(self, theta):
        return mt.FournierForand().pdf(theta)


class Negative(mt.PhaseFunction):
    def density(self, theta):
        return np.cos(theta)


class Layer(mt.BubblePopulation):
    b_surface: float = 0.2

    @property
    def e_folding(self):
        return 0.5

    def b(self, depth):
        return self.b_surface * np.exp(-np.asarray(depth) / self.e_folding)

    def phase_function(self):
        return mt.HenyeyGreenstein(g=0.8)


TWINS = [
    (TwinOfHenyeyGreenstein(), mt.HenyeyGreenstein(g=0.9)),
    (TwinOfFournierForand(), mt.FournierForand()),
]


@pytest.mark.parametrize(("own", "known"), TWINS)
def test_all_follows_from_the_density(own, known):
    theta = np.linspace(1e-4, np.pi, 20_001)
    np.testing.assert_allclose(own.pdf(theta), known.pdf(theta), rtol=3e-6)
    np.testing.assert_allclose(own.cdf(theta), known.cdf(theta), atol=1e-6)
    assert own.mean_cosine == pytest.approx(known.mean_cosine, abs=1e-6)
    assert own.backscatter_fraction == pytest.approx(known.backscatter_fraction, rel=1e-5)
    assert own.cdf(0.0) == 0.0
    assert own.cdf(np.pi) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("own", "known"), TWINS)
def test_kernels_sample_it(own, known):
    u = (np.arange(4000) + 0.5) / 4000
    s = phase.sample_s(own.tables(), u)
    np.testing.assert_allclose(known._cdf_s(s), u, atol=2e-6)


def test_densities_that_are_none_are_refused():
    with pytest.raises(
        Refused, match=r"^density: .* at theta = 1.57.*, allowed: finite numbers > 0"
    ):
        Negative().pdf(1.0)
    with pytest.raises(TypeError, match="abstract"):
        mt.PhaseFunction()


@pytest.mark.parametrize("estimator", ["forced", "analog"])
def test_links_take_own_parts_and_files_give_them_back(estimator, tmp_path):
    water = mt.Water(phase=TwinOfHenyeyGreenstein(g=0.924))
    link = mt.Link(water=water, bubbles=Layer(b_surface=0.1), receiver=mt.Receiver(radius=2.0))
    twin = link.replace("water.phase", mt.HenyeyGreenstein(g=0.924))
    own, known = (
        mt.simulate(x, FlatSea(), estimator, photons=2000, seed=3, threads=1) for x in (link, twin)
    )
    assert own.gain == pytest.approx(known.gain, rel=2e-4 if estimator == "forced" else 2e-2)
    own.save(tmp_path / "own.nc")
    loaded = mt.Scenario.from_provenance(mt.GainResult.load(tmp_path / "own.nc").provenance)
    assert loaded.link == link
    assert mt.Scenario.from_toml(loaded.to_toml()).link == link


def test_link_files_name_own_parts_by_import_path():
    text = (
        f"[water.phase]\nmodel = '{__name__}:TwinOfHenyeyGreenstein'\ng = 0.8\n"
        f"[bubbles]\nmodel = '{__name__}:Layer'\nb_surface = 0.3"
    )
    link = mt.Scenario.from_toml(text).link
    assert (link.water.phase, link.bubbles) == (TwinOfHenyeyGreenstein(g=0.8), Layer(b_surface=0.3))
    with pytest.raises(
        Refused, match=r"^bubbles\.b_surfac: 1, no such key, did you mean b_surface"
    ):
        mt.Scenario.from_toml(f"[bubbles]\nmodel = '{__name__}:Layer'\nb_surfac = 1")
