"""Deterministic unscattered light through tilts, and chains that try crossings, against searches.

The estimator by roots (`AimedChains.blurred = False`) draws the slope first and searches for every
crossing: it shares neither the density of slopes nor that of crossings.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.engine.chains import sets
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.photons import joined
from meshtrace.engine.setup import ends, meshing
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.stored import SHIFTS
from meshtrace.surfaces import Band, Elfouhaily, FlatSea, JonswapSea, SpectralSea
from meshtrace.surfaces.statistics import elfouhaily_slope_variance

SPACING = {4.0: 0.1, 8.0: 0.06, 16.0: 0.03, 24.0: 0.0157}


def sea_of(omega_max, seed=3, wind_speed=5.0, **options):
    spectrum = Elfouhaily(wind_speed=wind_speed, fetch=30e3)
    band = {"omega_min": 0.7, "omega_max": omega_max, "d_omega": 0.3, "d_theta": math.pi / 18.0}
    band = Band(**band | {key: options.pop(key) for key in band.keys() & options.keys()})
    return SpectralSea(
        spectrum=spectrum,
        spreading="elfouhaily",
        mss="elfouhaily",
        waves=band,
        seed=seed,
        **options,
    )


def mean_of(scores):
    """Return mean and standard error of the scores of a set of chains."""
    shifts = scores.reshape(SHIFTS, -1).mean(axis=1)
    return float(shifts.mean()), float(shifts.std(ddof=1) / math.sqrt(SHIFTS))


def searched(forced, aimed, order, chains, receiver=0):
    """Return mean and standard error of chains whose crossings are searched."""
    drawn = forced.drawer.draw(sets.Request(0, order, chains // SHIFTS, (7, 0, order, 1)))
    aimed.blurred = False
    found = mean_of(aimed.aim(0, receiver, drawn)[0])
    aimed.blurred = True
    return found


@pytest.mark.parametrize(
    ("omega_max", "chains"),
    [
        (4.0, 100_000),
        pytest.param(16.0, 100_000, marks=pytest.mark.slow),
        pytest.param(24.0, 100_000, marks=pytest.mark.slow),
    ],
)
def test_unscattered_light_against_chains(omega_max, chains):
    spacing = SPACING[omega_max]
    mesh = sea_of(omega_max).mesh(extent=6.0, spacing=spacing, fine_extent=0.65, coarse_spacing=0.4)
    forced = ForcedDetection(mt.Link(), 64, 1, sea=TypicalSea(0.6), scattered="chains")
    aimed = forced.planner.aim_over(mesh)
    gain = aimed.direct_gains(0, 0).sum()
    mean, stderr = searched(forced, aimed, 0, chains)
    assert stderr < 0.02 * mean
    assert abs(gain - mean) < 3.0 * math.hypot(stderr, 1e-3 * mean)


LINKS = {
    "narrow view": mt.Link(receiver=mt.Receiver(radius=0.3, fov_deg=14.0)),
    "position": mt.Link(physics=mt.Physics(fov="paper_position"), receiver=mt.Receiver(fov_deg=4)),
    "tilted": mt.Link(receiver=mt.Receiver(radius=0.1, position=(1.0, -0.6), tilt_deg=15.0)),
    "large": mt.Link(receiver=mt.Receiver(radius=1.0)),
    "near": mt.Link(receiver=mt.Receiver(radius=0.02, height=1.0)),
    "beam": mt.Link(
        transmitter=mt.GaussianBeam(divergence_deg=2.0), receiver=mt.Receiver(radius=0.2)
    ),
    "foam": mt.Link(
        physics=mt.Physics(fresnel="paper_both"), whitecaps=mt.Whitecaps(wind_speed=13.0)
    ),
}


@pytest.mark.parametrize("normals", ["vertex", "facet"])
@pytest.mark.parametrize("name", LINKS)
def test_unscattered_light_of_other_links(name, normals):
    link = LINKS[name]
    mesh = sea_of(4.0).mesh(extent=6.0, spacing=0.1, fine_extent=3.0)
    forced = ForcedDetection(link, 64, 1, normals, sea=TypicalSea(0.6), scattered="chains")
    aimed = forced.planner.aim_over(mesh)
    found = aimed.direct_gains(0, 0)
    assert found is not None
    mean, stderr = searched(forced, aimed, 0, 8192)
    # the edge of a narrow field of view and the parts of facets leave 2e-3
    assert z_test(found.sum(), math.hypot(stderr, 2e-3 * mean), mean) > sidak(ALPHA, 2 * len(LINKS))
    assert stderr < 0.05 * mean


@pytest.mark.parametrize("position", [(0.0, 0.0), (1.0, 0.0)])
def test_the_tail_of_a_beam_is_cut_finely_enough(position):
    """Alone the dim facets are bright ones, and cut into all of their parts."""
    beam = mt.GaussianBeam(depth=20.0, divergence_deg=0.1)
    link = mt.Link(transmitter=beam, receiver=mt.Receiver(height=30.0, position=position))
    mesh = sea_of(8.0).mesh(extent=6.0, spacing=0.05, fine_extent=2.0)
    aimed = ForcedDetection(link, 64, 1, sea=TypicalSea(0.6), scattered="chains").planner.aim_over(
        mesh
    )
    gain = aimed.direct_gains(0, 0)
    dim = np.flatnonzero((gain > 0.0) & (gain < 1e-5 * gain.max()))
    assert len(dim) > 0.5 * np.count_nonzero(gain)
    anew = aimed.direct_gains(0, 0, facets=dim)[dim]
    assert not np.array_equal(anew, gain[dim])
    assert anew.sum() == pytest.approx(gain[dim].sum(), rel=0.2)
    assert abs(anew.sum() - gain[dim].sum()) < 1e-5 * gain.sum()


@pytest.mark.parametrize("omega_max", [4.0, 8.0])
@pytest.mark.thorough
@pytest.mark.slow_but("4.0")
def test_chains_that_try_crossings_against_searched_ones(omega_max):
    receivers = (mt.Receiver(radius=0.1), mt.Receiver(radius=0.1, position=(2.0, 1.0), tilt_deg=10))
    link = mt.Link(water=mt.Water(b=0.1), receiver=receivers)
    mesh = sea_of(omega_max).mesh(
        extent=8.0, spacing=SPACING[omega_max], fine_extent=1.0, coarse_spacing=0.4
    )
    forced = ForcedDetection(link, 64, 1, sea=TypicalSea(0.6), scattered="chains")
    aimed = forced.planner.aim_over(mesh)
    for order in (0, 1, 3):
        drawn = forced.drawer.draw(sets.Request(0, order, 1024, (9, 0, order, 1)))
        for r in range(2):
            mean, stderr = mean_of(aimed.aim(0, r, drawn)[0])
            other, other_stderr = searched(forced, aimed, order, 4096, r)
            assert z_test(mean, math.hypot(stderr, other_stderr), other) > sidak(ALPHA, 12)
            assert stderr < 0.1 * mean


def test_arrivals_add_up_to_the_gain():
    result = mt.simulate(mt.Link(), sea_of(8.0), photons=512, record=["arrivals"])
    assert result.arrivals.weight.sum() == pytest.approx(result.gain, rel=1e-12)
    direct = result.arrivals.weight[result.arrivals.group < 0].sum()
    assert direct == pytest.approx(result.gain_ballistic, rel=1e-12)


@pytest.mark.parametrize(
    ("link", "variance"),
    [
        (mt.Link(), (1e-6, 1e-6)),
        (mt.Link(), (4e-3, 0.0)),
        (mt.Link(physics=mt.Physics(snell="paper")), (4e-3, 4e-3)),
    ],
)
@pytest.mark.thorough
def test_narrow_tilts_are_sampled(link, variance):
    """Tilts too narrow for the integration are drawn with chains, and the result says so."""
    sea = JonswapSea(wind_speed=5.0, seed=4, mss="band")
    made, _ = meshing.mesh_for(link, sea, reach=ends.crossing_reach(link))
    rough = UnresolvedSlopes(variance, variance, 20.0)
    mesh = mt.TriangleMesh(made.vertices, made.faces, made.vertex_normals, rough)
    result = mt.simulate(link, mesh, photons=4096, seed=1)
    assert result.chains.sampled == 1
    assert "sampled unscattered light" in result.summary(verbose=True)
    whole = mt.simulate(link, sea.replace(mss="cox-munk"), photons=256, seed=1)
    if link.physics.snell == "physical" and link.receiver.radius < 1.0:
        assert "sampled" not in whole.chains


def test_gains_that_are_sampled_and_integrated_agree():
    """The rule that chooses between both: the widest tilts that are sampled, a little wider."""
    made = JonswapSea(wind_speed=5.0, seed=4, mss="band").mesh(extent=6.0, spacing=0.1)
    slopes = made.vertex_normals[:, :2] / made.vertex_normals[:, 2:]
    edge = 0.01 * 0.5 * float((slopes**2).sum(axis=1).mean())
    gains = []
    for factor in (0.98, 1.02):
        rough = UnresolvedSlopes((factor * edge,) * 2, (factor * edge,) * 2)
        mesh = mt.TriangleMesh(made.vertices, made.faces, made.vertex_normals, rough)
        parts = ForcedDetection(mt.Link(), 8192, 1, scattered="chains").evaluate(mesh)
        assert parts.counts.sampled == (factor < 1.0)
        gains.append((parts.ballistic[0], parts.direct.std(ddof=1) / math.sqrt(SHIFTS)))
    (first, stderr), (second, none) = gains
    assert none == 0.0
    assert z_test(first, math.hypot(stderr, 2e-3 * first), second) > ALPHA


def closed_mean(link, heights):
    """Return the unscattered gain over flat seas with all slopes random, averaged over heights."""
    variance = elfouhaily_slope_variance(5.0, 30e3)
    total = 0.0
    x, weight = np.polynomial.hermite_e.hermegauss(5)
    for g, w in zip(x, weight / weight.sum(), strict=True):
        flat = FlatSea(height=heights * g).mesh(extent=6.0, spacing=0.1)
        rough = UnresolvedSlopes(variance, variance)
        mesh = mt.TriangleMesh(flat.vertices, flat.faces, flat.vertex_normals, rough)
        total += w * ForcedDetection(link, 64, 1, sea=TypicalSea(0.5)).evaluate(mesh).ballistic[0]
    return total


@pytest.mark.slow
@pytest.mark.statistical
def test_scintillation_and_mean_of_resolved_seas():
    """600 seas with waves up to 24 rad/s: published index and the closed mean."""
    sea = sea_of(24.0)
    found = mt.ensemble(mt.Link(), 600, sea, photons=256).gain_ballistic
    mean, stderr = found.mean(), found.std(ddof=1) / math.sqrt(len(found))
    heights = math.sqrt(0.5 * float(np.square(sea.components.amplitude).sum()))
    assert abs(mean - closed_mean(mt.Link(), heights)) < 3.0 * stderr
    share = (found / mean - 1.0) ** 2
    index, error = share.mean(), share.std(ddof=1) / math.sqrt(len(found))
    assert abs(index - 0.314) < 3.0 * error + 0.03 * 0.314


def test_threads_do_not_matter():
    runs = [mt.ensemble(mt.Link(), 4, sea_of(8.0), photons=128, threads=n) for n in (1, 3)]
    assert runs[0].gain.tobytes() == runs[1].gain.tobytes()


def test_meshes_resolve_the_shortest_waves():
    link = mt.Link()
    for omega_max, most in ((4.0, 15_000), (24.0, 60_000)):
        sea = sea_of(omega_max)
        mesh, _ = meshing.mesh_for(link, sea, reach=ends.crossing_reach(link), per_wave=0.9)
        x = np.unique(mesh.vertices[:, 0])
        shortest = np.hypot(sea.components.kx, sea.components.ky).max()
        assert np.diff(x).min() * shortest <= 0.91
        assert len(mesh.faces) < most
        assert (np.diff(x)[1:] / np.diff(x)[:-1]).max() < 1.11
    default, _ = meshing.mesh_for(link, JonswapSea(), reach=ends.crossing_reach(link))
    assert np.diff(np.unique(default.vertices[:, 0])).min() > 0.09
    given, _ = meshing.mesh_for(link, sea, mt.Meshing(spacing=0.2), reach=ends.crossing_reach(link))
    assert np.diff(np.unique(given.vertices[:, 0])).min() > 0.19


def test_the_default_mesh_resolves_a_gain_to_one_per_cent():
    link, errors = mt.Link(), []
    forced = ForcedDetection(link, 64, 1, sea=TypicalSea(0.6))
    for seed in range(8):
        sea = sea_of(16.0, seed, d_omega=0.6)
        mesh, _ = meshing.mesh_for(link, sea, reach=ends.crossing_reach(link))
        fine = sea.mesh(extent=6.0, spacing=0.009, fine_extent=0.8, coarse_spacing=0.1)
        gains = [forced.planner.aim_over(m).direct_gains(0, 0).sum() for m in (mesh, fine)]
        errors.append(gains)
    coarse, fine = np.array(errors).T
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 0.005 * fine.mean()


def test_light_crosses_within_the_lit_patch():
    """At least 0.999 of the unscattered light crosses where the mesh is fine."""
    links = (mt.Link(), mt.Link(receiver=mt.Receiver(position=(1.5, 0.0), tilt_deg=5.0)))
    for link in links:
        slope = math.sqrt(max(elfouhaily_slope_variance(5.0, 30e3)))
        center, half = link.lit_patch(slope)
        flat = FlatSea().mesh(extent=8.0, spacing=0.1)
        rough = UnresolvedSlopes((slope**2,) * 2, (slope**2,) * 2)
        mesh = mt.TriangleMesh(flat.vertices, flat.faces, flat.vertex_normals, rough)
        aimed = ForcedDetection(link, 64, 1, scattered="chains").planner.aim_over(mesh)
        gains = aimed.direct_gains(0, 0)
        beside = np.abs(aimed.centroids[:, :2] - center).max(axis=1) > half
        assert gains[beside].sum() < 1e-3 * gains.sum()


@pytest.mark.parametrize(("x", "height"), [(12.0, 3.0), (12.0, 1.2), (8.0, 1.2)])
@pytest.mark.thorough
@pytest.mark.slow_but("12.0-1.2")
def test_large_apertures_beside_the_critical_angle(x, height):
    """Light of steep slopes reaches the rim of an aperture, and none its centre."""
    link = mt.Link(
        water=mt.Water(a=0.179, b=0.0),
        transmitter=mt.Led(depth=4.0, half_angle_deg=60.0),
        receiver=mt.Receiver(position=(x, 0.0), height=height, radius=1.0, fov_deg=179.0),
    )
    mesh = sea_of(4.0).mesh(extent=18.0, spacing=0.4)
    aimed = ForcedDetection(link, 64, 1, sea=TypicalSea(0.6)).planner.aim_over(mesh)
    photons = joined.JoinedPhotons(link, 1_000_000, 1, direct=True).evaluate(mesh)
    gain, mean, stderr = (
        aimed.direct_gains(0, 0).sum(),
        photons.parts[0, 0],
        photons.part_stderr[0, 0],
    )
    assert stderr < 0.04 * mean
    assert z_test(gain, math.hypot(stderr, 2e-3 * mean), mean) > sidak(ALPHA, 3)
