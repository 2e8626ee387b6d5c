"""Background of a receiver in the air: sky, glint, light out of the water, foam."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from mc_statistics import z_test

import meshtrace as mt
from meshtrace.daylight import QuasiSingle, glint_radiance, sky_radiance
from meshtrace.errors import Refused
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.optics import Constituents, fresnel, fresnel_reflectance
from meshtrace.optics.fresnel import hemispheric_reflectance
from meshtrace.surfaces import FlatSea, GramCharlier, JonswapSea, SinusoidalSea
from meshtrace.surfaces.statistics import cox_munk

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data/daylight_downlink_reference.json").read_text()
)
SUN = mt.Daylight(direct=1.0, diffuse=0.0)
UNIFORM = mt.Daylight(direct=0.0, diffuse=math.pi, pattern="uniform")  # of radiance 1


def rough_plane(variances):
    """Return a level mesh that leaves out slopes of given variances, wind along x."""
    flat = FlatSea().mesh(extent=60.0, spacing=2.0)
    unresolved = UnresolvedSlopes(variances, variances, 0.0)
    return mt.TriangleMesh(flat.vertices, flat.faces, flat.vertex_normals, unresolved)


def _quasi_single(link, day):
    return QuasiSingle([link.water], [link.bubbles], link.water.n / link.n_air, [day])


def scattered_once(link, day, n, up):
    """Return the light of uniform water along one direction by the sum over sun and sky."""
    x, w = np.polynomial.legendre.leggauss(14)
    sines = np.sqrt(0.5 * (x + 1.0))
    phi = 2.0 * math.pi * (np.arange(20) + 0.5) / 20
    beams = [(np.array(day.sun), day.direct * day.sun[2])]
    for sine, weight in zip(sines, 0.5 * w, strict=True):
        for angle in phi:
            way = np.array([sine * math.cos(angle), sine * math.sin(angle), math.sqrt(1 - sine**2)])
            beams.append((way, weight * sky_radiance(day.sky, way)))
    scale = day.diffuse / sum(flux for _, flux in beams[1:])
    water, total = link.water, 0.0
    k = water.a + water.b * water.phase.backscatter_fraction
    for i, (way, flux) in enumerate(beams):
        down = np.array([-way[0] / n, -way[1] / n, 0.0])
        down[2] = -math.sqrt(1.0 - down @ down)
        below = (
            flux * (scale if i else 1.0) * (1.0 - fresnel_reflectance(way[2], 1.0, n)) / -down[2]
        )
        m = -1.0 / down[2] + 1.0 / up[2]
        phase = float(water.phase.pdf(math.acos(down @ up)))
        total += below * water.b * phase / (k * m) / up[2]
    return total


def test_light_out_of_the_water_is_the_sum_over_sun_and_sky():
    day, way = mt.Daylight(direct=1.4, diffuse=0.3), np.array(fresnel.unit_vector(35.0, 70.0))
    links = [
        mt.Link(),
        mt.Link(water=mt.Water.from_type("coastal")),
        mt.Link().replace("water.a", 0.3),
    ]
    days = [day, day.replace(direct=0.0), day.replace(diffuse=2.0)]
    waters, n = [one.water for one in links], 1.34
    found = QuasiSingle(waters, [None] * 3, n, days).upwelling(way[None])[0]
    wanted = [scattered_once(one, lit, n, way) for one, lit in zip(links, days, strict=True)]
    assert found == pytest.approx(wanted, rel=1e-4)  # tables of the angle and of the depth


def link(psi, **receiver):
    return mt.Link(receiver=mt.Receiver(fov_deg=2.0 * psi, **receiver))


@pytest.mark.parametrize(
    ("view", "sun", "wind", "key"),
    [((0, 0), 30, 5.0, "U5_sun30_v0"), ((20, 180), 30, 5.0, "U5_sun30_v20_180"),
     ((40, 150), 50, 10.0, "U10_sun50_v40_150")],
)  # fmt: skip
def test_glint_of_cox_and_munk(view, sun, wind, key):
    found = glint_radiance(
        np.array(fresnel.unit_vector(*view)),
        np.array(fresnel.unit_vector(sun, 0.0)),
        cox_munk(wind),
    )
    assert found == pytest.approx(REFERENCE["glint_over_E"][key], rel=2e-7)


def test_flux_of_glint_over_the_hemisphere():
    # int p rho(w) (s.n) / cos b over slopes, against the integral of the radiance
    n = 300
    sin2, phi = (np.arange(n) + 0.5) / n, 2.0 * math.pi * (np.arange(n) + 0.5) / n
    s, phi = np.meshgrid(np.sqrt(sin2), phi, indexing="ij")
    view = np.stack([s * np.cos(phi), s * np.sin(phi), np.sqrt(1.0 - s**2)], axis=-1)
    flux = math.pi * glint_radiance(view, np.array(SUN.sun), cox_munk(5.0)).mean()
    assert flux == pytest.approx(REFERENCE["glint_over_E"]["hemisphere_flux_U5_sun30"], rel=5e-3)


@pytest.mark.thorough
@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0])
def test_glint_of_skewed_slopes(azimuth_deg):
    """The reflected flux, int p rho(w) (s.n) / cos b over slopes, and the mean of a field of view."""
    law, variances, n = GramCharlier.cox_munk(10.0), cox_munk(10.0), 800
    sun = np.array(fresnel.unit_vector(50.0, azimuth_deg))
    sin2, phi = (np.arange(n) + 0.5) / n, 2.0 * math.pi * (np.arange(n) + 0.5) / n
    s, phi = np.meshgrid(np.sqrt(sin2), phi, indexing="ij")
    view = np.stack([s * np.cos(phi), s * np.sin(phi), np.sqrt(1.0 - s**2)], axis=-1)
    flux = math.pi * glint_radiance(view, sun, variances, 0.0, 1.33, law).mean()
    x = np.arange(-7.0, 7.0, 0.02) + 0.01
    a, c = np.meshgrid(x, x, indexing="ij")  # the series as printed, with eta = -a
    mass = 0.02**2 * np.exp(-0.5 * (a**2 + c**2)) / (2.0 * math.pi)
    mass *= (
        1.0 + 0.5 * law.c21 * (c**2 - 1.0) * a + law.c03 * (a**3 - 3.0 * a) / 6.0
        + law.c40 * (c**4 - 6.0 * c**2 + 3.0) / 24.0 + law.c22 * (c**2 - 1.0) * (a**2 - 1.0) / 4.0
        + law.c04 * (a**4 - 6.0 * a**2 + 3.0) / 24.0
    )  # fmt: skip
    area = np.stack([-math.sqrt(variances[0]) * a, -math.sqrt(variances[1]) * c, np.ones_like(a)])
    facing = np.einsum("i...,i", area, sun)
    size = np.linalg.norm(area, axis=0)
    normal = area / size
    away = 2.0 * facing / size * normal[2] - sun[2]  # height of the mirrored ray
    rho = fresnel_reflectance(np.clip(facing / size, 0.0, 1.0), 1.0, 1.33)
    wanted = (mass * rho * facing * ((facing > 0.0) & (away > 0.0))).sum()
    assert flux == pytest.approx(wanted, rel=5e-3)
    flat = rough_plane(variances)
    slopes = flat.unresolved._replace(cumulants=law.cumulants(variances))
    mesh = mt.TriangleMesh(flat.vertices, flat.faces, flat.vertex_normals, slopes)
    day = SUN.replace(sun_zenith_deg=50.0, sun_azimuth_deg=azimuth_deg)
    found = mt.background(link(10.0), mesh, day, photons=65536, water="none").parts["glint"]
    # points of the disk of directions, alike in sin^2
    r, turn = math.sin(math.radians(10.0)) * s, phi
    view = np.stack([r * np.cos(turn), r * np.sin(turn), np.sqrt(1.0 - r**2)], axis=-1)
    closed = glint_radiance(view, sun, variances, 0.0, 1.33, law).mean()
    assert found == pytest.approx(closed, rel=2e-3)
    plain = glint_radiance(view, sun, variances, 0.0, 1.33).mean()
    # the steepest slopes ascend towards the wind, and mirror a low sun that stands downwind
    assert (closed > 1.2 * plain) == (azimuth_deg < 180.0)
    assert (closed < 0.8 * plain) == (azimuth_deg == 180.0)


@pytest.mark.parametrize("wind", [5.0, 13.0])
@pytest.mark.parametrize("psi", [3.0, 10.0, 30.0])
@pytest.mark.parametrize("zenith", [10, 30, 50])
@pytest.mark.slow_but(
    "10-3.0-5.0", "10-30.0-13.0", "30-10.0-5.0", "30-3.0-13.0", "50-30.0-5.0", "50-10.0-13.0"
)
def test_mean_glint_of_the_field_of_view(wind, psi, zenith):
    day = SUN.replace(sun_zenith_deg=zenith)
    found = mt.background(
        link(psi), rough_plane(cox_munk(wind)), day, photons=131072, water="none"
    ).parts["glint"]
    at = REFERENCE["glint_over_E"][f"cone_mean_U{wind:g}"]
    wanted = at[f"sun{zenith}"][at["psi"].index(psi)]
    assert found == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize(("psi", "wind"), [(30, 5), (10, 5), (30, 13)])
def test_mean_sky_of_the_field_of_view(psi, wind):
    day = mt.Daylight(direct=0.0, diffuse=0.295018)
    found = mt.background(
        link(psi), rough_plane(cox_munk(wind)), day, photons=32768, water="none"
    ).parts["sky"]
    wanted = REFERENCE["sky_reflected_mean"]["cie12_sun30"][f"psi{psi}_U{wind}"]
    assert found == pytest.approx(wanted, rel=1e-3)


@pytest.mark.thorough
def test_glint_of_a_hundred_seas_is_that_of_cox_and_munk():
    # a wide disk that looks straight down averages over 60 m of sea
    at = mt.Link(receiver=mt.Receiver(fov_deg=1.0, radius=60.0))
    sea, mesh = JonswapSea(wind_speed=5.0), mt.Meshing(extent=64.0, spacing=1.0)
    found = [
        mt.background(at, sea.with_seed(i), SUN, photons=256, water="none", mesh=mesh)
        for i in range(100)
    ]
    glint = np.array([f.parts["glint"] for f in found])
    stderr = glint.std(ddof=1) / 10.0
    wanted = REFERENCE["glint_over_E"]["U5_sun30_v0"]
    assert stderr < 0.02 * wanted
    assert abs(glint.mean() - wanted) < 3.0 * stderr
    assert glint.mean() == pytest.approx(wanted, rel=0.03)


def test_the_level_sea_mirrors_one_sun():
    day = SUN.replace(sun_azimuth_deg=77.0)
    # the mean over the disk of the sun, 3.6e-6 from the value in its middle
    u, v = np.meshgrid(*(2 * [(np.arange(200) + 0.5) / 200]))
    radius, phi = math.radians(0.2665) * np.sqrt(u), 2.0 * math.pi * v
    cos_z = np.cos(radius) * math.cos(math.radians(30.0)) - np.sin(radius) * np.cos(phi) * 0.5
    sin2 = math.sin(math.radians(40.0)) ** 2
    wanted = float(np.mean(fresnel_reflectance(cos_z, 1.0, 1.33) * cos_z)) / (math.pi * sin2)
    assert mt.background(link(40.0), FlatSea(), day).parts["glint"] == pytest.approx(wanted)
    assert mt.background(link(29.0), FlatSea(), day).parts["glint"] == 0.0


@pytest.mark.slow
def test_glint_of_a_smooth_sea_is_the_limit_of_small_unresolved_slopes():
    sea, mesh = SinusoidalSea(amplitude=0.03, wavelength=4.0), mt.Meshing(extent=8.0, spacing=0.1)
    smooth = sea.mesh(extent=8.0, spacing=0.1)
    smooth = mt.TriangleMesh(smooth.vertices, smooth.faces, smooth.vertex_normals)
    spread = (4e-5, 4e-5)
    rough = mt.TriangleMesh(
        smooth.vertices, smooth.faces, smooth.vertex_normals, UnresolvedSlopes(spread, spread)
    )
    at = link(40.0, radius=0.5)
    exact = mt.background(at, smooth, SUN, photons=4096, water="none", mesh=mesh)
    blurred = mt.background(at, rough, SUN, photons=262144, water="none", mesh=mesh)
    stderr = math.hypot(exact.radiance_stderr, blurred.radiance_stderr)
    assert stderr < 0.06 * exact.radiance
    assert z_test(exact.radiance, stderr, blurred.radiance) > 1e-4


def test_black_water_shows_the_reflectance_of_the_sea():
    # a hemispheric view of the level sea: 0.065931 of a uniform sky
    found = mt.background(link(90.0), FlatSea(), UNIFORM, photons=131072, water="none")
    wanted = REFERENCE["uniform_sky_still_water"]["reflected_from_air"]
    assert wanted == pytest.approx(hemispheric_reflectance(1.0, 1.33), rel=1e-5)
    assert found.radiance == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("pair", ["20/135", "30/135", "40/135", "40/90", "60/135"])
def test_reflectance_of_mobley_1999(pair):
    zenith, azimuth = map(float, pair.split("/"))
    both = 0.5 * sum(cox_munk(4.0))
    day = mt.Daylight(direct=0.0, diffuse=1.0, pattern="harrison-coombes")
    receiver = {"height": 5.0, "tilt_deg": zenith, "tilt_azimuth_deg": azimuth}
    at = link(0.5, **receiver).replace("water.n", 1.34)
    found = mt.background(at, rough_plane((both, both)), day, photons=16384, water="none")
    # the table is for sky seen in the mirror direction: at the camera's own azimuth
    seen = float(sky_radiance(day.sky, np.array(fresnel.unit_vector(zenith, azimuth))))
    wanted = REFERENCE["rho_mobley_1999_table_U4_sun30"][pair]
    assert found.radiance / seen == pytest.approx(wanted, rel=0.09)
    if pair == "40/135":  # the fit of Ruddick et al. (2006)
        fit = 0.0256 + 0.00039 * 4.0 + 0.000034 * 4.0**2
        assert found.radiance / seen == pytest.approx(fit, rel=0.09)


@pytest.mark.parametrize(
    ("day", "key"),
    [(SUN, "Lw_over_Ed_sun30_nadir_quasi_single"),
     (UNIFORM, "Lw_over_Ed_uniform_nadir_quasi_single")],
)  # fmt: skip
def test_light_out_of_the_water(day, key):
    upwelling = _quasi_single(mt.Link(), day).upwelling(np.array([[0.0, 0.0, 1.0]]))[0, 0]
    leaving = upwelling * (1.0 - float(fresnel_reflectance(1.0, 1.0, 1.33))) / 1.33**2
    assert leaving / day.irradiance == pytest.approx(REFERENCE["water_leaving"][key], rel=1e-3)


def test_light_out_of_the_water_of_forward_photons():
    upwelling = _quasi_single(mt.Link(), SUN).upwelling(np.array([[0.0, 0.0, 1.0]]))[0, 0]
    leaving = upwelling * (1.0 - float(fresnel_reflectance(1.0, 1.0, 1.33))) / 1.33**2
    wanted = REFERENCE["water_leaving"]["forward_photons_sun30"]
    assert abs(leaving / SUN.irradiance - wanted["value"]) < 4.0 * wanted["stderr"]


def test_reflectance_below_the_surface_against_walks_and_published_laws():
    # light that leaves 20 degrees from the zenith, away from the sun
    leaving = REFERENCE["water_leaving"]
    through = 1.0 - float(fresnel_reflectance(SUN.sun[2], 1.0, 1.33))
    view = np.array([fresnel.unit_vector(20.0, 180.0)])
    r_rs = _quasi_single(mt.Link(), SUN).upwelling(view)[0, 0] / (through * SUN.irradiance)
    assert r_rs == pytest.approx(leaving["r_rs_view20"]["value"], rel=0.015)
    # Gordon et al. (1988) and Lee et al. (2002), for water with much more scattering
    u = 0.005908
    assert 0.0949 * u + 0.0794 * u**2 == pytest.approx(leaving["gordon"], rel=1e-3)
    assert 0.0895 * u + 0.1247 * u**2 == pytest.approx(leaving["lee"], rel=1e-3)
    for law in ("gordon", "lee"):
        assert r_rs == pytest.approx(leaving[law], rel=0.3)


@pytest.mark.parametrize("psi", ["60", "20", "5.967"])
def test_radiance_of_the_ranges_by_day(psi):
    day = mt.Daylight(direct=1.421482, diffuse=0.295018)
    found = mt.background(link(0.5 * float(psi)), rough_plane(cox_munk(5.0)), day, photons=8192)
    wanted = REFERENCE["ranges_m_ber1e-3"]["radiance"][psi]
    assert found.radiance == pytest.approx(wanted, rel=5e-3)
    if psi == "60":
        assert found.parts["sky"] == pytest.approx(2.08e-3, rel=1e-2)
        assert found.parts["glint"] == pytest.approx(1.465e-2, rel=1e-2)
        assert found.parts["water"] == pytest.approx(3.7e-4, rel=4e-2)


def test_still_water_reflects_40_135_as_mobley_1999():
    found = float(fresnel_reflectance(math.cos(math.radians(40.0)), 1.0, 1.34))
    wanted = REFERENCE["rho_mobley_1999_table_U4_sun30"]["U0_40/135"]
    assert found == pytest.approx(wanted, rel=2e-2)  # the table averages over 10 x 15 degrees


def test_flux_of_glint_of_still_water():
    cosine = SUN.sun[2]
    found = float(fresnel_reflectance(cosine, 1.0, 1.33)) * cosine
    assert found == pytest.approx(REFERENCE["glint_over_E"]["still_water_flux_sun30"], rel=1e-4)


def test_layers_equal_to_the_water_change_nothing():
    nadir = np.array([[0.3, 0.0, math.sqrt(0.91)]])
    plain, water = mt.Link(), mt.Link().water
    layered = plain.replace(water=water.replace(layers=((0.0, 0.114, 0.037), (9.0, 0.114, 0.037))))
    found = [_quasi_single(one, SUN).upwelling(nadir)[0, 0] for one in (plain, layered)]
    assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_bottom_of_clear_water_is_seen_through_it():
    clear = mt.Water(a=0.0, b=0.0, bottom_depth=20.0, bottom_albedo=0.5)
    nadir = np.array([[0.0, 0.0, 1.0]])
    found = _quasi_single(mt.Link(water=clear), UNIFORM).upwelling(nadir)[0, 0]
    wanted = 0.5 * (1.0 - hemispheric_reflectance(1.0, 1.33))  # E / pi of radiance 1
    assert found == pytest.approx(wanted, rel=2e-3)


def test_foam_covers_its_share():
    bare = link(30.0)
    covered = bare.replace(whitecaps=mt.Whitecaps(wind_speed=13.0))
    day = mt.Daylight(direct=1.42, diffuse=0.295)
    sea = rough_plane(cox_munk(5.0))
    without, with_foam = (mt.background(at, sea, day) for at in (bare, covered))
    share = 1.0 - covered.whitecaps.transmittance
    assert with_foam.parts["foam"] == pytest.approx(
        share * 0.22 * day.irradiance / math.pi, rel=1e-2
    )
    for part in ("glint", "water"):
        wanted = (1.0 - share) * without.parts[part]
        assert with_foam.parts[part] == pytest.approx(wanted, rel=1e-2)


def test_a_receiver_that_looks_at_the_sun_sees_it():
    at = link(40.0, tilt_deg=85.0)
    day = SUN.replace(sun_zenith_deg=80.0)
    cosine = math.cos(math.radians(15.0))
    wanted = cosine / (math.pi * math.sin(math.radians(40.0)) ** 2)
    assert mt.background(at, FlatSea(), day).parts["sun"] == pytest.approx(wanted)


@pytest.mark.parametrize("offset", [-0.4, -0.2, 0.0, 0.1, 0.4])
@pytest.mark.thorough_but("0.1")
def test_the_edge_of_the_view_cuts_the_disk_of_the_sun(offset):
    # share of a disk of 0.2665 deg beyond a straight edge, and of the circle about the view
    x = min(max(offset / 0.2665, -1.0), 1.0)
    wanted = 0.5 + (math.asin(x) + x * math.sqrt(1.0 - x * x)) / math.pi
    day = SUN.replace(sun_zenith_deg=80.0)
    at = link(20.0 + offset, tilt_deg=80.0)  # its axis is 20 deg from the sun
    full = math.cos(math.radians(20.0)) / (math.pi * math.sin(math.radians(20.0 + offset)) ** 2)
    found = mt.background(at, FlatSea(), day, photons=64, water="none").parts["sun"]
    assert found / full == pytest.approx(wanted, abs=5e-3)
    # mirrored: 128 points of the disk
    mirrored = mt.background(link(30.0 + offset), FlatSea(), SUN, water="none")
    cos_z, sin2 = SUN.sun[2], math.sin(math.radians(30.0 + offset)) ** 2
    full = float(fresnel_reflectance(cos_z, 1.0, 1.33)) * cos_z / (math.pi * sin2)
    assert mirrored.parts["glint"] / full == pytest.approx(wanted, abs=0.0 if x**2 == 1 else 0.15,
                                                           rel=1e-3)  # fmt: skip
    if offset == 0.0:  # opposite points of the disk: one of two is in the view
        assert mirrored.parts["glint"] / full == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("zenith", [0.0, 89.0])
def test_sun_at_the_zenith_and_at_the_horizon(zenith):
    day = SUN.replace(sun_zenith_deg=zenith)
    found = mt.background(link(88.0), FlatSea(), day, photons=256, water="none")
    cos_z, sin2 = day.sun[2], math.sin(math.radians(88.0)) ** 2
    wanted = float(fresnel_reflectance(cos_z, 1.0, 1.33)) * cos_z / (math.pi * sin2)
    assert found.parts["glint"] == pytest.approx(wanted if zenith == 0.0 else 0.0, rel=1e-3)
    for made in (mt.Daylight.overcast(zenith), mt.Daylight.moon(0.0, zenith)):
        assert made.irradiance > 0.0


@pytest.mark.parametrize("place", ["air", "water"])
def test_blocks_of_rays_change_no_digit(place, monkeypatch):
    day, sea = mt.Daylight(direct=1.42, diffuse=0.295), JonswapSea(wind_speed=8.0)
    end = link(40.0) if place == "air" else mt.Link(receiver=mt.WaterAperture(depth=3.0))
    whole = mt.background(end, sea, day, photons=1024, water="none")
    monkeypatch.setattr("meshtrace.engine.backward.view._BLOCK", 100)  # three shifts at a time
    parts = mt.background(end, sea, day, photons=1024, water="none")
    assert parts.part_radiance.tobytes() == whole.part_radiance.tobytes()
    assert parts.part_radiance_stderr.tobytes() == whole.part_radiance_stderr.tobytes()


def test_threads_and_files_change_no_digit(tmp_path):
    day, sea = mt.Daylight(direct=1.42, diffuse=0.295), JonswapSea(wind_speed=8.0)
    one, two = (mt.background(link(20.0), sea, day, photons=256, threads=t) for t in (1, 2))
    assert one.part_radiance.tobytes() == two.part_radiance.tobytes()
    one.save(tmp_path / "b.nc")
    loaded = mt.Background.load(tmp_path / "b.nc")
    assert loaded.summary() == one.summary()
    assert loaded.parts == one.parts


def test_counts_follow_filter_and_lens():
    b = mt.background(link(30.0), FlatSea(), mt.Daylight(direct=1.42, diffuse=0.295))
    wide = mt.OokLink()
    narrow = wide.replace("optics.filter_width_nm", 2.0)
    assert b.count_rate(narrow) == pytest.approx(0.2 * b.count_rate(wide))
    etendue = math.pi * 9.43e-6 * 1.5**2  # of the detector limits the lens
    wanted = 0.3 * b.radiance * 10.0 * etendue / 4.226480547e-19
    assert b.count_rate(wide) == pytest.approx(wanted, rel=1e-9)
    with pytest.raises(Refused, match=r"^optics.filter_width_nm: 1000.*, allowed: <= 940, twice"):
        b.count_rate(wide.replace("optics.filter_width_nm", 1000.0))
    assert b.power_per_nm == pytest.approx(b.radiance * math.pi**2 * 0.05**2 * 0.25)


def test_refusals():
    with pytest.raises(Refused, match="daylight: "):
        mt.background(mt.Link(), FlatSea())
    with pytest.raises(Refused, match="photons"):
        mt.background(mt.Link(), FlatSea(), SUN, photons=8)
    with pytest.raises(Refused, match="water: 'deep'"):
        mt.background(mt.Link(), FlatSea(), SUN, water="deep")
    two = mt.Link(receiver=(mt.Receiver(), mt.Receiver(height=7.0)))
    with pytest.raises(Refused, match="one aperture"):
        mt.background(two, FlatSea(), SUN)


def test_few_walks_at_several_wavelengths():
    """One photon a shift cannot follow two indices: once "parts[0][2]: nan"."""
    water = mt.Water(spectrum=Constituents(chlorophyll=0.5), wavelength_nm=500.0)
    day, waves = mt.Daylight.clear_sky(sun_zenith_deg=30.0), [450.0, 500.0, 550.0]
    few, many = (
        mt.background(
            mt.Link(water=water), FlatSea(), day, photons=n, wavelengths_nm=waves, water="walk"
        )
        for n in (32, 4096)
    )
    for (_, a), (_, b) in zip(few, many, strict=True):
        assert z_test(a.radiance, a.radiance_stderr, b.radiance, b.radiance_stderr) > 1e-4
        assert a.radiance_stderr > b.radiance_stderr
