"""Several wavelengths with common paths against direct runs of each."""

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy.stats import chi2

import meshtrace as mt
from meshtrace.engine import correlated
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.photons import analog, joined
from meshtrace.engine.setup import arrays, ends, meshing
from meshtrace.engine.setup.options import resolve
from meshtrace.engine.setup.tinting import photon_paths, tinting
from meshtrace.errors import Refused
from meshtrace.results import load, tallies
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore:.*effective sample size:meshtrace.FewSamplesWarning"),
]

SEAS = {"flat": FlatSea(), "wavy": JonswapSea(wind_speed=5.0, seed=2)}
WATERS = {
    "clear": [{"a": 0.114, "b": 0.037}, {"a": 0.05, "b": 0.02}, {"a": 0.3, "b": 0.1}],
    "coastal": [{"a": 0.179, "b": 0.22}, {"a": 0.1, "b": 0.3}, {"a": 0.4, "b": 0.1}],
}
CASES = [(water, sea) for water in WATERS for sea in SEAS]
TYPED = mt.Link(water=mt.Water.from_type("jerlov-II"))


def links_of(waters, link=None):
    link = link or mt.Link()
    return [link.replace(water=link.water.replace(**water)) for water in waters]


def mesh_of(link, sea):
    case = resolve(link, sea)
    return meshing.mesh_for(case.link, case.surface, case.meshing, ends.crossing_reach(case.link))[
        0
    ]


def compare(found, direct, tests):
    """Compare (gain, error) at each wavelength with independent ones."""
    for (gain, error), (other, its_error) in zip(found, direct, strict=True):
        p = z_test(gain, error, other, its_error)
        assert p > sidak(ALPHA, tests), f"{gain} +- {error}, direct {other} +- {its_error}"


def forced(links, mesh, photons=4096, seed=1):
    sea = TypicalSea.of_meshes([mesh])
    parts = correlated.SpectralDetection(links, photons, seed, sea=sea).at_wavelengths(mesh)
    return [(p.gain[0], p.stderr[0]) for p in parts]


def one_by_one(links, mesh, photons=4096, seed=100):
    sea, found = TypicalSea.of_meshes([mesh]), []
    for k, link in enumerate(links):  # independent of each other
        parts = ForcedDetection(link, photons, seed + k, sea=sea).evaluate(mesh)
        found.append((parts.gain[0], parts.stderr[0]))
    return found


@pytest.mark.parametrize(("water", "sea"), CASES)
def test_chains_bring_the_light_of_all_wavelengths(water, sea):
    links = links_of(WATERS[water])
    mesh = mesh_of(links[1], SEAS[sea])
    compare(forced(links, mesh), one_by_one(links, mesh), 12)


def test_unscattered_light_has_no_noise():
    """Light of a facet at a third wavelength follows from two: 1e-5 of direct runs."""
    waters = [{"a": a, "b": 0.05} for a in (0.02, 0.2, 0.5)]
    links = links_of(waters)
    for sea in SEAS.values():
        mesh = mesh_of(links[0], sea)
        parts = correlated.SpectralDetection(links, 64, 1).at_wavelengths(mesh)
        direct = [ForcedDetection(link, 64, 1).evaluate(mesh) for link in links]
        found = [p.ballistic[0] / d.ballistic[0] for p, d in zip(parts, direct, strict=True)]
        assert found == pytest.approx(np.ones(3), abs=1e-5)


@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.slow
def test_joined_photons_bring_the_light_of_all_wavelengths(sea):
    other = mt.FournierForand(n=1.12)
    links = links_of([{"a": 0.18, "b": 0.3}, {"a": 0.1, "b": 0.25, "phase": other},
                      {"a": 0.4, "b": 0.15}])  # fmt: skip
    mesh = mesh_of(links[1], SEAS[sea])
    common = tinting(links[0], links, arrays.frame_of(links[0]))
    parts = joined.JoinedPhotons(links[0], 2**15, 1).at_wavelengths(mesh, common, links)
    alone = [
        joined.JoinedPhotons(link, 2**15, 9 + k).evaluate(mesh) for k, link in enumerate(links)
    ]
    for part in (1, 2):  # scattered, and reflected first
        rows = [
            [(p.parts[part, 0], p.part_stderr[part, 0]) for p in found] for found in (parts, alone)
        ]
        compare(*rows, 12)
    same = joined.JoinedPhotons(links[0], 2**15, 1).evaluate(mesh)
    assert parts[0].groups == pytest.approx(same.groups, rel=1e-12)
    assert parts[0].orders == pytest.approx(same.orders, rel=1e-12)


def mean_of(runs):
    """Return the means (gain, error) of independent runs."""
    gain, error = np.moveaxis(np.array(list(runs)), -1, 0)
    return np.transpose([gain.mean(axis=0), np.linalg.norm(error, axis=0) / len(error)])


def analog_one_by_one(links, surface, n, seed=40):
    return [
        analog.run_analog(link, surface, photons=n, seed=seed + k) for k, link in enumerate(links)
    ]


def rows_of(sums, n):
    """Return (gain, error) of sums of photons."""
    return [(s.score[0] / n, np.sqrt(s.score_squared[0]) / n) for s in sums]


@pytest.mark.parametrize(("water", "sea"), CASES)
@pytest.mark.slow
def test_analog_photons_bring_the_light_of_all_wavelengths(water, sea):
    wide = mt.Link(receiver=mt.Receiver(radius=1.0, fov_deg=120.0))
    links = links_of(WATERS[water], wide)
    mesh = meshing.mesh_for(links[1], SEAS[sea], mt.Meshing(spacing=0.2))[0]
    surface, n = mt.EmbreeIntersector(mesh, 1), 2**17
    sums = correlated.analog_sums(links, surface, mt.Analog(), n, None, seed=1)
    compare(rows_of(sums, n), rows_of(analog_one_by_one(links, surface, n), n), 12)


@pytest.mark.parametrize("estimator", ["forced", "analog"])
@pytest.mark.parametrize(("water", "sea"), CASES)
@pytest.mark.thorough
@pytest.mark.slow_but("clear-flat-forced")
def test_common_paths_agree_to_two_thousandths(water, sea, estimator):
    """Each of 24 gains within 0.2 % and 3 standard errors (by chance one beyond: 6 %)."""
    if estimator == "forced":
        links, runs = links_of(WATERS[water]), {"clear": 1, "coastal": 16}[water]
        mesh = mesh_of(links[1], SEAS[sea])
        found, direct = (
            mean_of(run(links, mesh, 2**16, seed=first + 10 * k) for k in range(runs))
            for run, first in ((forced, 1), (one_by_one, 1000))
        )
    else:  # a wide aperture, which most photons reach
        links, n = links_of(WATERS[water], mt.Link(receiver=mt.Receiver(radius=10.0))), 2**21
        mesh = meshing.mesh_for(links[1], SEAS[sea], mt.Meshing(spacing=0.4))[0]
        surface = mt.EmbreeIntersector(mesh, 1)
        found = rows_of(correlated.analog_sums(links, surface, mt.Analog(), n, None, seed=1), n)
        direct = rows_of(analog_one_by_one(links, surface, n), n)
    (gain, error), (other, its_error) = (np.transpose(rows) for rows in (found, direct))
    z = (gain - other) / np.hypot(error, its_error)
    print(water, sea, estimator, gain / other - 1.0, z)
    assert abs(gain / other - 1.0).max() < 2e-3
    assert abs(z).max() <= 3.0


LAYERS = [
    [(0.0, 0.1, 0.2), (4.0, 0.12, 0.3), (10.0, 0.12, 0.15)],
    [(0.0, 0.2, 0.1), (4.0, 0.1, 0.25), (10.0, 0.3, 0.05)],
]


@pytest.mark.slow
def test_photons_in_layers():
    wide = mt.Link(receiver=mt.Receiver(radius=1.0, fov_deg=120.0))
    links = [wide.replace(water=mt.Water(layers=rows)) for rows in LAYERS]
    mesh = meshing.mesh_for(links[0], SEAS["wavy"], mt.Meshing(spacing=0.2))[0]
    surface, n = mt.EmbreeIntersector(mesh, 1), 2**16
    sums = correlated.analog_sums(links, surface, mt.Analog(), n, None, seed=1)
    compare(rows_of(sums, n), rows_of(analog_one_by_one(links, surface, n), n), 4)
    common = tinting(links[0], links, arrays.frame_of(links[0]))
    parts = joined.JoinedPhotons(links[0], 2**14, 1).at_wavelengths(mesh, common, links)
    alone = [
        joined.JoinedPhotons(link, 2**14, 9 + k).evaluate(mesh) for k, link in enumerate(links)
    ]
    compare(*([(p.parts[1, 0], p.part_stderr[1, 0]) for p in found] for found in (parts, alone)), 4)


@pytest.mark.slow
def test_layers_and_bubbles():
    bubbles = mt.HallNovarini(wind_speed=10.0)
    base = mt.Link(bubbles=bubbles)
    links = [
        base.replace(water=mt.Water(layers=LAYERS[0])),
        base.replace(water=mt.Water(layers=LAYERS[1])),
        base.replace(water=mt.Water(layers=LAYERS[0]), bubbles=bubbles.replace(q=1.5)),
    ]
    sea = JonswapSea(wind_speed=10.0, seed=2)
    mesh = mesh_of(links[0], sea)
    compare(forced(links, mesh, 8192), one_by_one(links, mesh, 8192), 3)


@pytest.mark.thorough
def test_photons_below_bubbles():
    """Which of water and bubbles scatters a joined photon is drawn for its factors."""
    wide = mt.Link(
        bubbles=mt.HallNovarini(wind_speed=12.0),
        transmitter=mt.Led(depth=6.0, half_angle_deg=60.0),
        receiver=mt.Receiver(radius=2.0, fov_deg=120.0, height=5.0),
    )
    links = links_of(WATERS["coastal"], wide)
    mesh = mesh_of(links[0], SEAS["flat"])
    surface, n = mt.EmbreeIntersector(mesh, 1), 2**17
    sums = correlated.analog_sums(links, surface, mt.Analog(), n, None, seed=1)
    compare(rows_of(sums, n), rows_of(analog_one_by_one(links, surface, n), n), 6)
    base = links[1]  # scatters most
    common = tinting(base, links, arrays.frame_of(base))
    assert common.follows
    parts = joined.JoinedPhotons(base, 2**14, 1).at_wavelengths(mesh, common, links)
    alone = [
        joined.JoinedPhotons(link, 2**14, 9 + k).evaluate(mesh) for k, link in enumerate(links)
    ]
    compare(*([(p.parts[1, 0], p.part_stderr[1, 0]) for p in found] for found in (parts, alone)), 6)


def test_a_downlink():
    link = mt.Link().mirrored()
    links = links_of(WATERS["coastal"], link)
    mesh = mesh_of(links[1], SEAS["wavy"])
    compare(forced(links, mesh), one_by_one(links, mesh), 3)


def test_gains_follow_the_index_of_the_water():
    waters = [{**w, "n": n} for w, n in zip(WATERS["clear"], (1.345, 1.3375, 1.33), strict=True)]
    links = links_of(waters)
    mesh = mesh_of(links[1], SEAS["flat"])
    compare(forced(links, mesh), one_by_one(links, mesh), 3)
    parts = correlated.SpectralDetection(links, 64, 1).at_wavelengths(mesh)
    for part, link in zip(parts, links, strict=True):
        direct = ForcedDetection(link, 64, 1).evaluate(mesh)
        assert part.ballistic == pytest.approx(direct.ballistic, rel=2e-4)


@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.slow
def test_photons_of_several_bases(sea):
    """Turbid water, in which paths of one wavelength are rare at another."""
    links = links_of([{"a": 0.3, "b": 1.8}, {"a": 0.1, "b": 1.2}, {"a": 0.2, "b": 0.7}])
    mesh = mesh_of(links[1], SEAS[sea])
    _, common = photon_paths(links, range(3))
    assert len(common.tinting.bases) > 1
    assert common.tinting.follows
    parts = joined.JoinedPhotons(links[0], 2**15, 1).at_wavelengths(mesh, common.tinting, links)
    alone = [
        joined.JoinedPhotons(link, 2**15, 9 + k).evaluate(mesh) for k, link in enumerate(links)
    ]
    for part in (1, 2):  # scattered, and reflected first
        rows = [
            [(p.parts[part, 0], p.part_stderr[part, 0]) for p in found] for found in (parts, alone)
        ]
        compare(*rows, 12)
    errors = [[p.part_stderr[1, 0] / p.parts[1, 0] for p in found] for found in (parts, alone)]
    assert (np.array(errors[0]) < 4.0 * np.array(errors[1])).all()


@pytest.mark.thorough
def test_a_wavelength_far_from_the_base_has_its_paths():
    """An eighth of the scattering: its error is no larger than that of the base."""
    links = links_of([{"a": 0.1, "b": 1.2}, {"a": 0.1, "b": 1.15}, {"a": 0.5, "b": 0.15}])
    mesh = mesh_of(links[0], SEAS["flat"])
    sea = TypicalSea.of_meshes([mesh])
    found = correlated.SpectralDetection(links, 8192, 1, sea=sea).at_wavelengths(mesh)
    alone = ForcedDetection(links[2], 8192, 7, sea=sea).evaluate(mesh)
    error = [(p.stderr / p.gain)[0] for p in found]
    assert error[2] < error[0]
    compare([(found[2].gain[0], found[2].stderr[0])], [(alone.gain[0], alone.stderr[0])], 1)


def test_one_wavelength_is_a_usual_run():
    kw = {"photons": 512, "seed": 4, "spacing": 0.5}
    found = mt.simulate(TYPED, FlatSea(), wavelengths_nm=[520.0], **kw).at_wavelength(520.0)
    alone = mt.simulate(TYPED.at_wavelength(520.0), FlatSea(), **kw)
    assert (found.gain, found.gain_stderr) == (alone.gain, alone.gain_stderr)
    assert found.provenance["link"] == alone.provenance["link"]


@pytest.mark.parametrize("estimator", ["forced", "analog"])
def test_threads_do_not_change_a_bit(estimator):
    kw = {"photons": 8192, "seed": 4, "spacing": 0.5, "wavelengths_nm": [450.0, 550.0]}
    one = mt.simulate(TYPED, SEAS["wavy"], estimator, threads=1, **kw)
    two = mt.simulate(TYPED, SEAS["wavy"], estimator, threads=2, **kw)
    assert one["gain"].equals(two["gain"])
    assert one["gain_stderr"].equals(two["gain_stderr"])


def test_a_result_has_a_dimension_of_wavelength(tmp_path):
    two = TYPED.replace(receiver=(mt.Receiver(), mt.Receiver(height=8.0)))
    kw = {"photons": 512, "spacing": 0.5, "wavelengths_nm": [550.0, 450.0, 500.0]}
    found = mt.simulate(two, FlatSea(), **kw)
    assert found["gain"].dims == ("wavelength", "receiver")
    assert found["wavelength_nm"].to_numpy().tolist() == [450.0, 500.0, 550.0]
    found.save(tmp_path / "result.nc")
    kept = load(tmp_path / "result.nc")
    assert kept["gain"].equals(found["gain"])
    assert kept.summary() == found.summary()
    one, other = found.at_wavelength(500.0), kept.at_wavelength(500.0)
    assert one.summary() == other.summary()
    assert one.provenance == other.provenance
    assert [nm for nm, _ in kept] == [450.0, 500.0, 550.0]


def test_refusals():
    with pytest.raises(Refused, match="spectrum"):
        mt.simulate(mt.Link(), FlatSea(), wavelengths_nm=[450.0, 500.0])
    with pytest.raises(Refused, match="given twice"):
        mt.simulate(TYPED, FlatSea(), wavelengths_nm=[450.0, 450.0])
    grid = mt.IrradianceMap(height=5.0, extent=1.0, step=0.5)
    with pytest.raises(Refused, match="record"):
        mt.simulate(TYPED, FlatSea(), "analog", wavelengths_nm=[450.0], record=[grid])
    found = mt.simulate(TYPED, FlatSea(), photons=64, spacing=1.0, wavelengths_nm=[450.0])
    with pytest.raises(Refused, match="450"):
        found.at_wavelength(460.0)


def scatter_of(runs):
    """Return the p-value that (gain, error) of runs scatter by their errors, by chi-square."""
    gain, error = np.transpose(runs)
    n = len(gain) - 1.0
    return chi2.sf(n * gain.var(ddof=1) / np.mean(error**2), n)


@pytest.mark.slow
def test_errors_of_a_far_wavelength_are_true():
    """Scatter of 64 seeds over the stated error, chi-square of 63 degrees of freedom.

    Of chains, with a wide index; of joined photons of two bases; of analog photons of two bases
    and indices that many reach.
    """
    far = [{"a": 0.05, "b": 0.4, "n": 1.345}, {"a": 0.5, "b": 0.15, "n": 1.33}]
    turbid = [{"a": 0.3, "b": 1.8}, {"a": 0.2, "b": 0.7}]
    links, opaque = links_of(far), links_of(turbid)
    mesh = mesh_of(links[0], SEAS["wavy"])
    sea = TypicalSea.of_meshes([mesh])
    wide = links_of(far, mt.Link(receiver=mt.Receiver(radius=10.0)))
    surface = mt.EmbreeIntersector(
        meshing.mesh_for(wide[1], SEAS["wavy"], mt.Meshing(spacing=0.4))[0], 1
    )
    common = photon_paths(opaque, range(2))[1].tinting
    rows = [[], [], []]
    for seed in range(64):
        part = correlated.SpectralDetection(links, 1024, seed, sea=sea).at_wavelengths(mesh)[1]
        rows[0].append((part.gain[0], part.stderr[0]))
        found = joined.JoinedPhotons(opaque[0], 2**13, seed).at_wavelengths(mesh, common, opaque)[1]
        rows[1].append((found.parts[1, 0], found.part_stderr[1, 0]))
        sums = correlated.analog_sums(wide, surface, mt.Analog(), 2**13, None, seed=seed)[1]
        n = sums.photons
        rows[2].append(
            (sums.score[0] / n, tallies.standard_error(sums.score, sums.score_squared, n)[0])
        )
    for runs in rows:
        assert sidak(ALPHA, 6) < scatter_of(runs) < 1.0 - sidak(ALPHA, 6)


@pytest.mark.thorough
def test_few_samples_are_warned_of_at_the_worst_wavelength():
    """Once each wavelength had a warning of its own."""
    water = mt.Water(spectrum=mt.optics.Constituents(chlorophyll=1.0), wavelength_nm=500.0)
    link = mt.Link(water=water, receiver=mt.Receiver(fov_deg=20.0)).at_depth(30.0)
    sea = JonswapSea(wind_speed=5.0, seed=1)
    with pytest.warns(mt.FewSamplesWarning, match="400 nm, the wavelength of fewest") as found:
        mt.simulate(link, sea, photons=64, spacing=0.5, wavelengths_nm=[400.0, 500.0, 620.0])
    assert len(found) <= 2


@pytest.mark.parametrize("sea", SEAS.values(), ids=SEAS)
def test_the_error_of_unscattered_light_is_that_of_one_wavelength(sea):
    """It once compared light at the base with that at another wavelength: 593 % over still water."""
    waters = [{"a": 0.114, "b": 1e-4}, {"a": 0.05, "b": 1e-4}, {"a": 0.3, "b": 1e-4}]
    links = links_of(waters)
    mesh = mesh_of(links[0], sea)
    for together, link in zip(forced(links, mesh, 512), links, strict=True):
        gain, error = forced([link], mesh, 512)[0]
        assert together[0] == pytest.approx(gain, rel=1e-3)
        assert together[1] / together[0] < 3.0 * error / gain + 1e-4


def test_water_that_does_not_scatter_has_gains_at_several_wavelengths(tmp_path):
    """Once a ValueError: no orders of scattering to arrange."""
    table = tmp_path / "clear.csv"
    table.write_text("wavelength,a,b\n450,0.05,0\n500,0.06,0\n550,0.07,0\n")
    link = mt.Link(water=mt.Water.from_file(table, 500.0))
    several = mt.simulate(link, FlatSea(), wavelengths_nm=[450, 500, 550], photons=64)
    for nm, result in zip((450, 500, 550), several.results, strict=True):
        single = mt.simulate(link.at_wavelength(nm), FlatSea(), photons=64)
        assert result.gain == pytest.approx(single.gain, rel=1e-4)
