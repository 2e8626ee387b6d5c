"""Irradiance under a moving sea: still water, closed forms, energy, photons, flashes, refusals."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.apps import irradiance
from meshtrace.daylight.light import SUN_RADIUS_DEG
from meshtrace.fading import scintillation_of_spectrum
from meshtrace.kernels import sources
from meshtrace.optics import fresnel_reflectance
from meshtrace.optics.fresnel import refract
from meshtrace.results import IrradianceSeries, load
from meshtrace.surfaces import (
    Elfouhaily,
    FlatSea,
    JonswapSea,
    SinusoidalSea,
    SpectralSea,
    resolved_sea,
)

CLEAR = mt.Water(a=0.0, b=0.0)
OVERHEAD = mt.Daylight(direct=1.0, diffuse=0.0, sun_zenith_deg=0.0)
SLANTED = mt.Daylight(direct=1.2, diffuse=0.0, sun_zenith_deg=40.0, sun_azimuth_deg=30.0)
SHORT = SpectralSea(
    spectrum=Elfouhaily(wind_speed=5.0, fetch=3e3), omega_max=25.0, mss="band", seed=3,
    spreading="elfouhaily",
)  # fmt: skip


def series(sea, day=OVERHEAD, **options):
    return mt.irradiance_series(sea, day, threads=1, **{"water": CLEAR, **options})


@pytest.mark.parametrize("day", [OVERHEAD, SLANTED], ids=["overhead", "slanted"])
def test_still_water_is_snell_fresnel_and_the_way(day):
    found = series(
        FlatSea(), day, water=mt.Water(a=0.1, b=0.0), depths=[1.0, 7.0], patch=(0.3, 0.05)
    )
    cos_i = day.sun[2]
    cos_t = math.sqrt(1.0 - (1.0 - cos_i**2) / 1.33**2)
    through = day.direct * cos_i * (1.0 - float(fresnel_reflectance(cos_i, 1.0, 1.33)))
    wanted = through * np.exp(-0.1 * np.array([1.0, 7.0]) / cos_t)
    np.testing.assert_allclose(found.still, wanted, rtol=1e-3)  # of the index of the air
    np.testing.assert_allclose(found.irradiance[0], found.still, rtol=1e-6)
    np.testing.assert_allclose(found.pattern[0, 1], found.still[1], rtol=1e-3)


def refracted(z, zx, zy, corner, spacing, sun, n, c, depth):
    """Return places and powers of the points of a surface."""
    x, y = (corner[i] + spacing * np.arange(z.shape[i]) for i in (0, 1))
    normal = np.stack([-zx, -zy, np.ones_like(z)], axis=-1)
    long = np.linalg.norm(normal, axis=-1)
    normal /= long[..., None]
    cosine = normal @ np.array(sun)
    ray = refract(np.broadcast_to(-np.array(sun), normal.shape), normal, 1.0, n)
    way = (z + depth) / -ray[..., 2]
    power = spacing**2 * long * cosine * (1.0 - fresnel_reflectance(cosine, 1.0, n))
    place = np.stack([*np.meshgrid(x, y, indexing="ij")], axis=-1) + way[..., None] * ray[..., :2]
    return place, power * np.exp(-c * way)


def test_the_kernel_follows_the_rays_of_its_twin():
    rng = np.random.default_rng(1)
    z, zx, zy = 0.2 * rng.normal(size=(3, 7, 6))
    args = (z, zx, zy, (-0.3, -0.2), 0.1, SLANTED.sun, 1.33, 0.2, 2.0)
    light = np.zeros((400, 400))
    sources.land_sunlight(*args, (-2.0, -2.0), 0.01, light)
    place, power = refracted(*args)
    inside = (np.abs(place) < 1.9).all(axis=-1)
    wanted = power[inside].sum()
    assert light.sum() == pytest.approx(wanted, rel=1e-12)
    cells = -2.0 + 0.01 * (np.arange(400) + 0.5)
    for axis in (0, 1):  # shared out between cells: the centre of the light stays
        centre = (light.sum(axis=1 - axis) * cells).sum() / wanted
        assert centre == pytest.approx((power * place[..., axis])[inside].sum() / wanted, abs=1e-12)


def test_a_passing_wave_is_the_density_of_rays():
    """E / E_still = 1 / (1 - eps cos kx) for small slopes, eps = (1 - 1/n) d A k^2."""
    wave = SinusoidalSea(amplitude=0.002, wavelength=1.0)
    k, depth = 2.0 * math.pi, 4.0
    n = mt.Link().water.n / mt.Link().n_air
    found = series(wave, depths=[depth], collector=0.02, patch=(1.0, 0.02))
    eps = (1.0 - 1.0 / n) * depth * 0.002 * k**2
    crossing = np.linspace(-2.0, 2.0, 400_001)
    landing = crossing + (1.0 - 1.0 / n) * depth * 0.002 * k * -np.sin(k * crossing)
    exact = 1.0 / (1.0 - eps * np.cos(k * crossing))
    # collector and sun's image average over their disks, of second moments r^2 / 4
    radius = np.hypot(0.01, math.radians(0.2665) * depth / n)
    blur = np.exp(-0.125 * (k * radius) ** 2)
    got = found.pattern[0, 0, :, found.y.size // 2] / found.still[0]
    wanted = np.interp(found.x, landing, exact)
    np.testing.assert_allclose(got, 1.0 + blur * (wanted - 1.0), atol=0.02 * eps + 2e-3)


def test_gravity_waves_of_any_size_flicker_alike():
    """Froude's law: lengths by s, times by sqrt(s), the sun's angle unchanged."""
    times, s = np.linspace(0.0, 0.7, 8), 4.0
    small = series(
        SinusoidalSea(amplitude=0.01, wavelength=0.6, direction_deg=20.0),
        depths=[1.5], collector=0.03, times=times,
    )  # fmt: skip
    large = series(
        SinusoidalSea(amplitude=0.01 * s, wavelength=0.6 * s, direction_deg=20.0),
        depths=[1.5 * s], collector=0.03 * s, times=times * math.sqrt(s),
    )  # fmt: skip
    assert small.cv[0] > 0.1
    np.testing.assert_allclose(large.irradiance, small.irradiance, rtol=1e-3)


def test_the_mean_over_a_patch_is_the_light_that_enters():
    sea = SinusoidalSea(amplitude=0.05, wavelength=1.0, direction_deg=20.0)
    dark = mt.Water(a=0.2, b=0.0)
    found = series(
        sea, SLANTED, water=dark, depths=[3.0], patch=(2.0, 0.1), times=[0.3], collector=0.3
    )
    # one wave: the mean over whole wavelengths of the power of its points
    x = np.linspace(0.0, 1.0, 201)[:-1]
    c, s = math.cos(math.radians(20.0)), math.sin(math.radians(20.0))
    z, zx, zy = (
        a[:, None] for a in (sea.elevation(c * x, s * x, 0.3), *sea.slopes(c * x, s * x, 0.3))
    )
    n = mt.Link().water.n / mt.Link().n_air
    _, power = refracted(z, zx, zy, (0.0, 0.0), 1.0, SLANTED.sun, n, 0.2, 3.0)
    wanted = 1.2 * power.mean()
    px, py = np.meshgrid(found.x, found.y, indexing="ij")
    window = np.cos(0.25 * np.pi * px) ** 2 * np.cos(0.25 * np.pi * py) ** 2
    got = (window * found.pattern[0, 0]).sum() / window.sum()
    assert got == pytest.approx(wanted, rel=0.01)


@pytest.mark.statistical
@pytest.mark.thorough
@pytest.mark.parametrize(
    ("wind", "depth", "collector", "seas"),
    [(5.0, 1.0, 0.05, 16), (8.0, 3.0, 0.1, 16), (5.0, 10.0, 0.3, 16), (13.0, 1.0, 0.1, 16)],
)
@pytest.mark.slow_but("5.0-1.0-0.05-16")
def test_cv_is_the_closed_form(wind, depth, collector, seas):
    """Within 5 %, and three standard errors of the seas."""
    moments = []
    for seed in range(seas):
        found = series(
            resolved_sea(wind, seed=seed), depths=[depth], collector=collector, below="waves",
            times=7.3 * np.arange(120),
        )  # fmt: skip
        e = found.irradiance[:, 0]
        moments.append((e.mean(), np.mean(e**2)))
    mean, square = np.array(moments).T
    cv = math.sqrt(square.mean() / mean.mean() ** 2 - 1.0)
    each = np.sqrt(square / mean**2 - 1.0)
    error = each.std(ddof=1) / math.sqrt(seas)
    # by reciprocity a lamp far above; the sun's image adds to the second moment of the collector
    radius = math.hypot(0.5 * collector, math.radians(0.2665) * depth / 1.33)
    link = mt.Link(
        water=CLEAR, transmitter=mt.AirLed(height=1e6),
        receiver=mt.WaterReceiver(depth=depth, radius=radius, fov_deg=180.0),
    )  # fmt: skip
    wanted = math.sqrt(scintillation_of_spectrum(link, resolved_sea(wind)))
    assert abs(cv - wanted) < 0.05 * wanted + 3.0 * error


@pytest.mark.thorough
def test_photons_under_the_mesh_make_the_same_pattern():
    water = mt.Water(a=0.1, b=0.0)
    found = series(SHORT, water=water, depths=[1.0], collector=0.05, patch=(0.25, 0.05))
    mesh = SHORT.mesh(extent=0.8, spacing=0.008)
    link = mt.Link(
        water=water, transmitter=mt.Sun(half_width=0.7), receiver=(),
        planes=mt.IrradiancePlanes(depths=(1.0,)),
    )  # fmt: skip
    record = [mt.IrradianceMap(height=-1.0, extent=0.305, step=0.01, axis=(0.0, 0.0, -1.0))]
    run = mt.simulate(link, mesh, estimator="analog", photons=2_000_000, seed=4, record=record)
    disk = np.hypot(*np.meshgrid(*2 * [np.arange(-2.0, 3.0)])) < 2.5
    photons = np.array(run.map.irradiance) * 1.4**2
    got = np.array(
        [[(photons[i - 2 : i + 3, j - 2 : j + 3] * disk).sum() / disk.sum()
          for j in range(30 - 25, 30 + 26, 5)] for i in range(30 - 25, 30 + 26, 5)]
    )  # fmt: skip
    pattern = found.pattern[0, 0]
    assert got.mean() == pytest.approx(pattern.mean(), rel=0.02)
    assert got.std() / got.mean() == pytest.approx(pattern.std() / pattern.mean(), rel=0.05)
    assert np.corrcoef(got.ravel(), pattern.ravel())[0, 1] > 0.99


@pytest.mark.thorough
def test_frames_agree_with_background_series():
    # long waves: rays of the series are few for the caustics of short ones
    sea, times = SHORT.model_copy(update={"omega_max": 10.0}), 0.21 * np.arange(6)
    found = series(sea, depths=[1.5], collector=0.05, times=times)
    link = mt.Link(
        water=CLEAR, transmitter=mt.AirLed(),
        receiver=mt.WaterReceiver(depth=1.5, radius=0.025, fov_deg=180.0),
    )  # fmt: skip
    mesh = mt.Meshing(extent=1.0, spacing=0.02)
    other = mt.background_series(link, sea, OVERHEAD, times, photons=8192, mesh=mesh, threads=1)
    wanted, error = math.pi * other.parts["sun"], math.pi * other.part_radiance_stderr[:, -1]
    assert wanted.std() > 0.05 * wanted.mean()
    assert (np.abs(found.irradiance[:, 0] - wanted) < 3.5 * error + 0.01 * wanted).all()
    assert np.corrcoef(found.irradiance[:, 0], wanted)[0, 1] > 0.98


@pytest.mark.thorough
def test_scattered_light_and_sky_add_a_steady_part():
    day = mt.Daylight(direct=1.0, diffuse=0.3, sun_zenith_deg=20.0)
    water = mt.Water(a=0.1, b=0.2)
    options = {"depths": [3.0], "times": [0.0, 0.4, 0.8], "photons": 20_000}
    murky = series(SHORT, day, water=water, **options)
    assert (murky.unscattered < murky.irradiance).all()
    bare = series(SHORT, day, water=mt.Water(a=0.3, b=0.0), **{**options, "photons": 1000})
    np.testing.assert_allclose(murky.unscattered, bare.unscattered, rtol=0.02)  # other cells
    still = series(FlatSea(), day, water=water, **options)
    profile = mt.simulate(
        mt.Link(water=water, transmitter=mt.Sun(zenith_deg=20.0), receiver=(),
                planes=mt.IrradiancePlanes(depths=(3.0,))),
        FlatSea(), estimator="analog", photons=40_000, seed=9,
    ).planes  # fmt: skip
    sun = still.irradiance[0, 0] - still.sky[0]
    assert sun == pytest.approx(day.sun[2] * float(profile.e_d[0]), rel=0.02)


def test_seeds_and_threads_leave_every_digit():
    options = {"depths": [1.0], "times": 0.1 * np.arange(5), "water": mt.Water(a=0.1, b=0.1)}
    one, two = (
        mt.irradiance_series(SHORT, SLANTED, photons=1000, threads=n, **options) for n in (1, 3)
    )
    np.testing.assert_array_equal(one.irradiance, two.irradiance)
    part = mt.irradiance_series(
        SHORT, SLANTED, photons=1000, threads=1, **{**options, "times": options["times"][3:4]}
    )
    np.testing.assert_array_equal(part.irradiance[0], one.irradiance[3])


def test_finer_points_change_nothing():
    coarse, fine = (series(SHORT, times=[0.0, 0.1], fineness=f).irradiance for f in (1.0, 2.0))
    np.testing.assert_allclose(coarse, fine, rtol=3e-3)


@pytest.mark.parametrize("below", ["still", "waves"])
def test_tiles_give_the_light_of_one_grid(below, monkeypatch):
    options = {"times": [0.0, 0.1], "depths": [2.0], "patch": (0.2, 0.05), "below": below}
    whole = series(SHORT, SLANTED, **options)
    monkeypatch.setattr(irradiance, "_MOST_LINES", 150)
    tiled = series(SHORT, SLANTED, **options)
    assert tiled.provenance["surface_points"][0] > 150**2
    np.testing.assert_allclose(tiled.pattern, whole.pattern, rtol=1e-4)
    np.testing.assert_allclose(tiled.irradiance, whole.irradiance, rtol=1e-4)


@pytest.mark.thorough
@pytest.mark.slow_but("8.0")
@pytest.mark.parametrize("wind", [5.0, 8.0])
def test_a_small_collector_counts_the_rays_that_hit_it(wind):
    radius, depth, n = 0.0035, 1.0, 1.33 / mt.Link().n_air
    found = series(JonswapSea(wind_speed=wind, seed=1), below="waves", collector=2.0 * radius)
    (omega,) = found.provenance["omega_max"]
    sea = JonswapSea(wind_speed=wind, seed=1).for_fading.model_copy(update={"omega_max": omega})
    lines = 0.00023 * np.arange(-1000, 1001)
    z, zx, zy = sea.grid(lines, lines, 0.0)
    z -= z.mean()
    place, power = refracted(
        z, zx, zy, (lines[0], lines[0]), 0.00023, OVERHEAD.sun, n, 0.0, depth
    )  # fmt: skip
    rng = np.random.default_rng(1)
    tilt = (1.0 - 1.0 / n) * depth * np.sqrt(sea.slopes_beyond(omega))
    disk = math.radians(SUN_RADIUS_DEG) * depth / n
    near = np.hypot(place[..., 0], place[..., 1]) < radius + disk + 4.0 * tilt.max()
    place, power, hits = place[near], power[near], []
    for _ in range(64):
        r, phi = disk * np.sqrt(rng.random(len(place))), 2.0 * np.pi * rng.random(len(place))
        moved = place + np.stack([r * np.cos(phi), r * np.sin(phi)], axis=-1)
        moved += tilt * rng.normal(size=place.shape)
        hits.append(power[np.hypot(moved[:, 0], moved[:, 1]) < radius].sum())
    expected = np.mean(hits) / (math.pi * radius**2)
    # the level differs by the mean height over either grid; points are lines of a lattice
    assert found.irradiance[0, 0] == pytest.approx(expected, rel=0.02)


@pytest.mark.thorough
def test_small_collectors_over_a_disk_read_as_a_wide_one():
    sea = resolved_sea(5.0, fetch=3e3, seed=3).model_copy(update={"omega_max": 100.0})
    options = {"below": "waves", "times": [0.0]}
    wide = series(sea, collector=0.05, **options).irradiance[0, 0]
    small = series(sea, collector=0.007, patch=(0.025, 0.001), **options)
    x = 0.001 * (np.arange(small.pattern.shape[-1]) - small.pattern.shape[-1] // 2)
    over = np.hypot(x[:, None], x) <= 0.025
    # a collector's edge blurs that of the disk: (7 / 50)^2
    assert small.pattern[0, 0][over].mean() == pytest.approx(wide, rel=0.02)


def flashing(e, step=0.01):
    e = np.asarray(e, float)
    return IrradianceSeries(
        step * np.arange(len(e)), np.array([1.0]), e[:, None], e[:, None], np.zeros(1), np.ones(1)
    )


def test_flashes_are_counted_and_timed():
    found = flashing([0.5, 3.0, 3.0, 0.5, 0.5, 3.0, 0.5, 0.5, 0.5, 0.5, 0.5]).flashes([1.5, 9.0])
    assert found.per_minute[0].tolist() == pytest.approx([1200.0, 0.0])  # 2 in 0.1 s
    # rate times duration is the share of the time above the threshold
    assert found.duration[0, 0] * 20.0 == pytest.approx(3.0 / 11.0)
    assert math.isnan(found.duration[0, 1])


def test_spectra_find_a_wave():
    wave = 1.0 + 0.1 * np.cos(2.0 * np.pi * 5.0 * 0.01 * np.arange(400))
    frequency, density = flashing(wave).spectrum()
    assert frequency[density[0].argmax()] == pytest.approx(5.0)
    assert np.trapezoid(density[0], frequency) == pytest.approx(0.005, rel=0.05)
    sea = SinusoidalSea(amplitude=0.002, wavelength=0.5)
    k, density = series(sea, patch=(1.0, 0.05)).wavelengths()
    assert k[density[0].argmax()] == pytest.approx(2.0 * np.pi / 0.5, rel=0.05)
    values = flashing([1.0, 2.0, 3.0, 2.0]).pdf([0.0, 1.0, 2.0])
    assert values.sum() == pytest.approx(1.0)


def test_files_keep_a_series(tmp_path):
    found = series(FlatSea(), depths=[1.0, 2.0], times=[0.0, 1.0], patch=(0.1, 0.05))
    found.save(tmp_path / "e.nc")
    loaded = load(tmp_path / "e.nc")
    np.testing.assert_array_equal(loaded.pattern, found.pattern)
    assert loaded.summary() == found.summary()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"depths": [0.0]}, "depths: .*, allowed: at least one depth > 0"),
        ({"depths": []}, "depths"),
        ({"times": [math.nan]}, "times"),
        ({"collector": 0.0}, "collector"),
        ({"photons": 10}, "photons"),
        ({"patch": (0.1, 0.2)}, "patch: .*, 0 < edge <= half"),
        ({"fineness": 0.0}, "fineness"),
        ({"below": "crests"}, "below: 'crests', allowed: still, waves"),
        ({"water": mt.Water(layers=[(0.0, 0.1, 0.1), (5.0, 0.2, 0.1)])}, "water.layers"),
        ({"day": mt.Daylight(direct=0.0, diffuse=1.0)}, "daylight.direct: 0.0, allowed: > 0"),
        ({"sea": SinusoidalSea(amplitude=0.1, wavelength=2.0, choppy=True)}, "surface: choppy"),
        ({"sea": FlatSea().mesh()}, "surface: TriangleMesh"),
        ({"sea": resolved_sea(13.0)}, "depths: 1.0, allowed: > .* m, below all troughs"),
    ],
)
def test_invalid_inputs_are_refused(options, message):
    options = dict(options)
    sea, day = options.pop("sea", FlatSea()), options.pop("day", OVERHEAD)
    with pytest.raises(mt.Refused, match=message):
        series(sea, day, **options)


def test_a_scenario_gives_sea_light_water_and_seed():
    text = (
        "wind_speed = 4.0\n[sea]\nspectrum = 'flat'\n[water]\na = 0.2\nb = 0.0\n[run]\nseed = 3\n"
    )
    own = mt.Scenario.from_toml(text + "[daylight]\ndirect = 1.0\nsun_zenith_deg = 0.0\n")
    water = {"water": mt.Water(a=0.2, b=0.0), "depths": [1.0]}
    found = mt.irradiance_series(own, depths=[1.0])
    assert found.irradiance == mt.irradiance_series(FlatSea(), own.daylight, **water).irradiance
    assert found.provenance["run"]["seed"] == 3
    clear = mt.irradiance_series(mt.Scenario.from_toml(text), depths=[1.0]).provenance["daylight"]
    assert (clear["light"], clear["sun_zenith_deg"]) == ("clear sky", 30.0)
