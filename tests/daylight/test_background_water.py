"""Light through the surface: white furnace, still water, walks against closed forms."""

import json
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mc_statistics import z_test

import meshtrace as mt
from meshtrace.engine.backward import walk
from meshtrace.errors import Refused
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.optics import FournierForand
from meshtrace.surfaces import FlatSea, JonswapSea

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data/daylight_downlink_reference.json").read_text()
)
STILL = REFERENCE["under_still_water_cone60_over_Ed_air"]
SUN = mt.Daylight(direct=1.0, diffuse=0.0)
UNIFORM = mt.Daylight(direct=0.0, diffuse=1.0, pattern="uniform")
CONE = math.pi * math.sin(math.radians(30.0)) ** 2
ALPHA = 1e-4


def below(depth, fov_deg=60.0, tilt_deg=0.0, **link):
    aperture = mt.WaterAperture(depth=depth, fov_deg=fov_deg, zenith_deg=180.0 - tilt_deg)
    return mt.Link(receiver=aperture, **link)


@pytest.mark.parametrize("wind", [0.0, 13.0])
@pytest.mark.parametrize("tilt", [0.0, 40.0])
@pytest.mark.parametrize("place", ["air", "water"])
def test_white_furnace(wind, tilt, place):
    # light that nothing absorbs is the same everywhere: L in the air, n^2 L in the water
    day = mt.Daylight(direct=0.0, diffuse=math.pi, pattern="uniform", water="walk")
    water = mt.Water(a=0.0, b=0.05, bottom_depth=6.0, bottom_albedo=1.0)
    parts = {"water": water, "transmitter": mt.Led(depth=3.0)}
    link = below(3.0, tilt_deg=tilt, **parts)
    if place == "air":
        link = mt.Link(receiver=mt.Receiver(fov_deg=60.0, tilt_deg=tilt), **parts)
    if wind:
        link = link.in_wind(wind).replace(whitecaps=None)  # bubbles scatter, foam absorbs
    sea = JonswapSea(wind_speed=wind) if wind else FlatSea()
    mesh = mt.Meshing(extent=600.0, spacing=4.0)
    photons = 32768 if (wind, tilt, place) == (13.0, 40.0, "air") else 2048
    found = mt.background(link, sea, day, photons=photons, mesh=mesh)
    scale = 1.0 if place == "air" else link.water.n**2
    assert found.radiance_stderr < 1.5e-3 * scale
    assert found.radiance / scale == pytest.approx(1.0, abs=3e-3)


@pytest.mark.parametrize("i", range(3))
@pytest.mark.parametrize(("day", "key"), [(SUN, "sun30"), (UNIFORM, "uniform")])
@pytest.mark.thorough_but("day0-sun30-0", "day1-uniform-2")
def test_unscattered_light_under_still_water(i, day, key):
    water = mt.Water(a=0.151, b=0.0)  # c of the default water: scattering takes light away
    found = mt.background(below(STILL["depth"][i], water=water), FlatSea(), day, photons=65536)
    wanted = STILL[f"{key}_direct"][i]
    assert found.radiance * CONE / day.irradiance == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("i", range(3))
@pytest.mark.parametrize(("day", "key"), [(SUN, "sun30"), (UNIFORM, "uniform")])
@pytest.mark.thorough_but("day0-sun30-0", "day1-uniform-2")
def test_light_under_still_water(i, day, key):
    found = mt.background(below(STILL["depth"][i]), FlatSea(), day, photons=8192)
    scale = CONE / day.irradiance
    wanted, error = STILL[f"{key}_total"][i], STILL[f"{key}_stderr"][i]
    assert found.radiance_stderr * scale < 0.05 * wanted
    assert z_test(found.radiance * scale, found.radiance_stderr * scale, wanted, error) > ALPHA


def test_snell_s_window_of_clear_water():
    # looking up through still water without scattering: n^2 T L inside of 48.75 degrees, 0 outside
    clear = mt.Water(a=0.0, b=0.0)
    up = mt.background(below(2.0, 2.0, water=clear), FlatSea(), UNIFORM, photons=256)
    assert up.radiance * math.pi == pytest.approx(1.33**2 * (1.0 - 0.0200593), rel=1e-4)
    aside = below(2.0, 2.0, tilt_deg=60.0, water=mt.Water(a=1.0, b=0.0))
    assert mt.background(aside, FlatSea(), UNIFORM, photons=256).radiance == 0.0


def test_reflected_and_transmitted_sky_are_all_of_it():
    # flux down through still water, over that of the sky, plus the share that is reflected
    seen = mt.background(
        below(1e-3, 180.0, water=mt.Water(a=0.0, b=0.0)), FlatSea(), UNIFORM, photons=65536
    )
    reflected = mt.background(
        mt.Link(receiver=mt.Receiver(fov_deg=180.0)),
        FlatSea(),
        UNIFORM,
        photons=65536,
        water="none",
    )
    assert math.pi * (seen.radiance + reflected.radiance) == pytest.approx(1.0, rel=1e-3)


def test_sun_through_unresolved_slopes_tends_to_that_through_still_water():
    flat = FlatSea().mesh(extent=60.0, spacing=2.0)
    spread = (2e-4, 2e-4)
    rough = mt.TriangleMesh(
        flat.vertices, flat.faces, flat.vertex_normals, UnresolvedSlopes(spread, spread)
    )
    link = below(5.0, water=mt.Water(a=0.151, b=0.0))
    found = mt.background(link, rough, SUN, photons=16384)
    error, scale = found.radiance_stderr / found.radiance, CONE / SUN.irradiance
    assert error < 0.01
    wanted = STILL["sun30_direct"][1]
    assert found.radiance * scale == pytest.approx(wanted, rel=4.0 * error + 1e-3)


@pytest.mark.parametrize("slope_law", ["gaussian", "breon-henriot"])
def test_sun_under_waves_equals_forward_photons(slope_law):
    # forwards: the analog engine from a lit square onto the aperture, both on the same mesh
    wind = 5.0 if slope_law == "gaussian" else 12.0
    sea, mesh = (
        JonswapSea(wind_speed=wind, seed=2, slope_law=slope_law),
        mt.Meshing(extent=12.0, spacing=0.25),
    )
    made = mt.WaterAperture(depth=2.0, radius=1.0, fov_deg=100.0, zenith_deg=180.0)
    link = mt.Link(
        water=mt.Water(a=0.1, b=0.0),
        receiver=made,
        transmitter=mt.Sun(zenith_deg=30.0, azimuth_deg=180.0, half_width=4.0),
    )
    forward = mt.simulate(link, sea, "analog", photons=400_000, mesh=mesh)
    back = mt.background(link, sea, SUN, photons=16384, mesh=mesh)
    # of a unit irradiance the square receives 64 m2 times the cosine of the zenith angle
    lit = 64.0 * math.cos(math.radians(30.0))
    power, error = back.power_per_nm / lit, back.radiance_stderr * back.acceptance / lit
    assert error < 0.02 * power
    assert z_test(power, error, forward.gain, forward.gain_stderr) > ALPHA


@pytest.mark.thorough
def test_the_edge_of_the_view_cuts_the_disk_of_the_sun_under_water():
    at_edge = 2.0 * math.degrees(math.asin(0.5 / 1.33))
    water = mt.Water(a=0.1, b=0.0)
    parts = [
        mt.background(below(1.0, fov, water=water), FlatSea(), SUN)
        for fov in (at_edge, at_edge + 1)
    ]
    half, full = (p.parts["sun"] * p.acceptance for p in parts)
    assert half / full == pytest.approx(0.5, abs=1e-3)


@pytest.mark.thorough
def test_walk_equals_the_quasi_single_approximation():
    link = mt.Link(receiver=mt.Receiver(fov_deg=4.0))
    closed, walk = (
        mt.background(link, FlatSea(), SUN, water=water, photons=65536)
        for water in ("quasi-single", "walk")
    )
    assert walk.parts_stderr["water"] < 0.02 * walk.parts["water"]
    assert walk.parts["water"] == pytest.approx(closed.parts["water"], rel=0.03)
    leaving = REFERENCE["water_leaving"]
    # Gordon et al. (1988) below the surface, to 30 %
    r_rs = walk.parts["water"] * 1.33**2 / (1.0 - 0.0200593) / SUN.irradiance / 0.97
    assert r_rs == pytest.approx(leaving["gordon"], rel=0.3)


def test_blurred_phase_functions_keep_their_probability():
    phase = FournierForand()
    table = walk.blurred_phase(phase)
    theta = np.linspace(0.0, math.pi, len(table))
    total = 2.0 * math.pi * np.trapezoid(table * np.sin(theta), theta)
    assert total == pytest.approx(1.0, rel=2e-3)
    wide = theta > math.radians(60.0)
    np.testing.assert_allclose(table[wide], phase.pdf(theta[wide]), rtol=0.02)


@pytest.mark.parametrize(
    ("physics", "line"),
    [
        ("paper", "physics.absorption: 'paper', allowed: continuous"),
        ({"snell": "paper"}, "physics.snell: 'paper', allowed: physical"),
    ],
)
def test_published_forms_are_refused(physics, line):
    link = below(5.0).replace(physics=physics)
    with pytest.raises(Refused, match=line):
        mt.background(link, FlatSea(), UNIFORM)


def test_threads_and_batches_change_no_digit(monkeypatch):
    def radiance(threads):
        found = mt.background(below(5.0), JonswapSea(), SUN, photons=256, threads=threads)
        return found.part_radiance.tobytes()

    whole = radiance(1)
    # batches of few rays, which threads share
    small = partial(mt.Analog.model_construct, batch_size=64)
    monkeypatch.setattr(walk, "Analog", small)
    assert radiance(1) == radiance(2) == whole
