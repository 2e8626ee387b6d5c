"""Light from the air into the water: reciprocity, closed forms, both estimators, refusals."""

import json
import math
from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import typeof
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import brentq

import meshtrace as mt
from meshtrace import Vertex
from meshtrace.engine.chains.aimed import AimedChains
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.setup import meshing
from meshtrace.engine.setup.ends import crossing_reach, forced_link
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea, SinusoidalSea, sea_in_wind

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data/daylight_downlink_reference.json").read_text()
)
DIRECT = REFERENCE["downlink_direct"]
SQUARE = 1.33**2
WAVE = SinusoidalSea(amplitude=0.05, wavelength=3.0)
SWELL = SinusoidalSea(amplitude=0.5, wavelength=20.0)
TURBID = mt.Water(a=0.179, b=0.219)
EVEN = mt.Link(transmitter=mt.Led(half_angle_deg=60.0), receiver=mt.Receiver(fov_deg=180.0))


def down(lamp=None, radius=0.25, **receiver):
    return mt.Link(
        transmitter=lamp or mt.AirLed(), receiver=mt.WaterReceiver(radius=radius, **receiver)
    )


def through_still_water(link):
    """Return the unscattered gain through still water."""
    forced = ForcedDetection(link, 32, 1, scattered="chains")
    return float(forced.planner.aim_over(forced.planner.flat()).direct_gains(0, 0).sum())


BEAM = mt.AirBeam(height=20.0)


# Reciprocity: a Lambertian lamp over the cosine on its plane is 1 / pi, as the disk of the uplink


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("up", "sea"),
    [(EVEN, FlatSea()), (EVEN, WAVE), (EVEN.in_wind(13.0), sea_in_wind(13.0))],
    ids=["flat", "sinusoid", "all features"],
)
def test_the_mirrored_link_has_the_square_of_the_index_times_the_gain(up, sea):
    mesh, _ = meshing.mesh_for(up, sea, reach=crossing_reach(up))
    sea = TypicalSea.of_meshes([mesh])
    a, b = (
        ForcedDetection(link, 4096, 1, sea=sea, scattered="chains").evaluate(mesh)
        for link in (up, up.mirrored())
    )
    assert_allclose(b.ballistic, SQUARE * a.ballistic, rtol=1e-4)
    error = math.hypot(float(b.stderr[0]), SQUARE * float(a.stderr[0]))
    assert abs(b.gain[0] - SQUARE * a.gain[0]) < 4.0 * error
    if isinstance(sea, FlatSea):
        assert_allclose(b.gain, SQUARE * a.gain, rtol=1e-3)


def through_a_small_lens(link):
    """Return the light of a lamp under still, clear water through a lens, by Snell's root.

    I T exp(-a l) dOmega / dA, with the rays of the lamp as a map from angles to the lens's plane.
    """
    lamp, end, n = link.transmitter, link.receiver, link.water.n
    h, d, aside = end.height, lamp.depth, end.position[0]

    def landing(t):
        return d * math.tan(t) + h * math.tan(math.asin(n * math.sin(t)))

    t = brentq(lambda t: landing(t) - aside, 0.0, math.asin(1.0 / n) - 1e-9, xtol=1e-14)
    slope = (landing(t + 1e-6) - landing(t - 1e-6)) / 2e-6
    spread = math.sin(t) / aside / slope if aside > 1e-6 else slope**-2
    cos_w, cos_a = math.cos(t), math.cos(math.asin(n * math.sin(t)))
    r_s = ((n * cos_w - cos_a) / (n * cos_w + cos_a)) ** 2
    r_p = ((cos_w - n * cos_a) / (cos_w + n * cos_a)) ** 2
    w = np.array([math.sin(t), 0.0, cos_w])
    r = np.array([n * math.sin(t), 0.0, cos_a])
    intensity = (lamp.order + 1.0) / (2.0 * math.pi) * (w @ lamp.axis) ** lamp.order
    seen = abs(r @ end.axis) / cos_a * math.pi * end.radius**2
    loss = (1.0 - 0.5 * (r_s + r_p)) * math.exp(-link.water.a * d / cos_w)
    return intensity * spread * seen * loss


@settings(max_examples=8, deadline=None)
@given(
    st.floats(2.0, 30.0), st.floats(2.0, 30.0), st.floats(0.0, 5.0),
    st.floats(0.0, 20.0), st.floats(0.0, 20.0),
)  # fmt: skip
@pytest.mark.thorough
def test_swapped_ends_of_even_patterns_have_the_square_of_the_index(h, d, aside, tilt, lean):
    clear = mt.Water(b=0.0)
    lamp = mt.Led(half_angle_deg=60.0, depth=d, zenith_deg=lean, azimuth_deg=30.0)
    end = mt.Receiver(
        fov_deg=180.0, height=h, radius=0.02, position=(aside, 0.0), tilt_deg=tilt,
        tilt_azimuth_deg=70.0,
    )  # fmt: skip
    up = mt.Link(water=clear, transmitter=lamp, receiver=end)
    a, b = through_still_water(up), through_still_water(up.mirrored())
    # parts of the facets under the image of the lens: up to 2e-4
    assert a == pytest.approx(through_a_small_lens(up), rel=4e-4)
    assert b == pytest.approx(SQUARE * through_a_small_lens(up), rel=4e-4)


# Closed forms of unscattered light


def on_axis(order, h, d, radius, fov_deg, a=0.114, b=0.037, n=1.33):
    """Return the unscattered gain of an LED through still water, by quadrature over its angle."""

    def landing(t):
        return h * math.tan(t) + d * math.tan(math.asin(math.sin(t) / n))

    low, high = 0.0, math.radians(89.9)
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if landing(middle) < radius else (low, middle)
    if n * math.sin(math.radians(fov_deg / 2.0)) < 1.0:
        low = min(low, math.asin(n * math.sin(math.radians(fov_deg / 2.0))))

    def light(t):
        cos_t, cos_w = math.cos(t), math.sqrt(1.0 - (math.sin(t) / n) ** 2)
        rs = (cos_t - n * cos_w) / (cos_t + n * cos_w)
        rp = (n * cos_t - cos_w) / (n * cos_t + cos_w)
        through = (1.0 - 0.5 * (rs * rs + rp * rp)) * math.exp(-(a + b) * d / cos_w)
        return (order + 1.0) * cos_t**order * math.sin(t) * through

    return quad(light, 0.0, low, epsabs=0.0, epsrel=1e-10)[0]


CASES = {
    "D1": (mt.AirLed(), 60.0, mt.Water()),
    "D2": (mt.AirLed(half_angle_deg=60.0), 180.0, mt.Water()),
    "D5": (BEAM, 20.0, mt.Water()),
    "D6": (mt.AirLed(), 120.0, TURBID),
}


def direct():
    """Yield name, link and gain of the unscattered light of the reference."""
    for name, (lamp, fov, water) in CASES.items():
        for radius in (0.05, 0.25):
            link = down(lamp, radius, fov_deg=fov).replace(water=water)
            yield f"{name} {radius}", link, DIRECT[name][f"r{radius}"]
        clear = down(lamp, 0.05, fov_deg=fov).replace(water=mt.Water(a=0.0, b=0.0))
        yield f"{name} clear", clear, DIRECT[name]["r0.05_a0_b0"]
    for depth, gain in DIRECT["D1_depths_r0.05"].items():
        yield f"{depth} m", down(radius=0.05, depth=float(depth)), gain


@pytest.mark.parametrize(("link", "expected"), [c[1:] for c in direct()],
                         ids=[c[0] for c in direct()])  # fmt: skip
def test_unscattered_light_meets_the_quadrature(link, expected):
    assert through_still_water(link) == pytest.approx(expected, rel=2e-4)
    lamp, end, water = link.transmitter, link.receiver, link.water
    if isinstance(lamp, mt.AirLed):
        shape = lamp.order, 5.0, end.depth, end.radius, end.fov_deg
        assert on_axis(*shape, water.a, water.b) == pytest.approx(expected, rel=2e-6)


def test_a_field_of_view_cuts_the_light_of_a_wide_receiver():
    link = mt.Link(
        water=mt.Water(b=0.0), transmitter=mt.AirLed(half_angle_deg=60.0),
        receiver=mt.WaterReceiver(radius=3.0, fov_deg=12.0),
    )  # fmt: skip
    closed = on_axis(1.0, 5.0, 10.0, 3.0, 12.0, b=0.0)
    assert closed < 0.8 * on_axis(1.0, 5.0, 10.0, 3.0, 180.0, b=0.0)
    assert through_still_water(link) == pytest.approx(closed, rel=1e-3)


def test_small_apertures_reach_the_paraxial_limit():
    link = down(radius=1e-3).replace(water=mt.Water(b=0.0))
    order, d, h, c = link.transmitter.order, 10.0, 5.0, 0.114
    through = 1.0 - (0.33 / 2.33) ** 2
    limit = 0.5 * (order + 1.0) * (1.33 * 1e-3 / (d + 1.33 * h)) ** 2 * math.exp(-c * d) * through
    assert through_still_water(link) == pytest.approx(limit, rel=1e-4)
    default = limit * 50.0**2 * math.exp(-0.037 * d)  # 5 cm, c = 0.151
    assert default == pytest.approx(DIRECT["D1"]["limit_small_r0.05"], rel=1e-8)
    assert through_still_water(down(radius=0.05)) == pytest.approx(default, rel=5e-4)


def test_defaults_are_those_of_the_reference():
    water, constants = mt.Link().water, REFERENCE["constants"]
    assert (water.n, water.a, water.b) == tuple(
        constants[k] for k in ("n", "default_a", "default_b")
    )


@pytest.mark.thorough
def test_without_refraction_both_directions_are_alike():
    water = mt.Water(b=0.0, n=1.0001)
    up = EVEN.replace(water=water)
    a, b = through_still_water(up), through_still_water(up.mirrored())
    assert b == pytest.approx(a, rel=5e-4)


@pytest.mark.parametrize("radius", [0.05, 0.25])
@pytest.mark.parametrize(("spacing", "tolerance"), [(0.1, 5e-3), (0.02, 5e-4)])
def test_a_sinusoid_meets_the_quadrature(spacing, tolerance, radius):
    link = down(mt.AirLed(), radius)
    mesh = WAVE.mesh(0.0, 2.5, spacing)
    found = (
        ForcedDetection(link, 32, 1, scattered="chains")
        .planner.aim_over(mesh)
        .direct_gains(0, 0)
        .sum()
    )
    assert found == pytest.approx(DIRECT["S1"][f"r{radius}"], rel=tolerance)


@pytest.mark.filterwarnings("ignore:receiver 0. the mesh causes")  # 0.6 % on 4 cm
@pytest.mark.thorough
def test_a_wave_that_passes_flickers_by_its_focusing():
    """SI = (1 - eps^2)^(-1/2) - 1, eps = beta A k^2, for a small aperture before the caustic."""
    link = mt.Link(
        water=mt.Water(a=0.0, b=0.0), transmitter=mt.AirLed(height=50.0),
        receiver=mt.WaterReceiver(radius=0.005, fov_deg=180.0),
    )  # fmt: skip
    period = 2.0 * math.pi / math.sqrt(9.81 * 2.0 * math.pi / 3.0)
    times = np.arange(24) * period / 24.0
    gain = np.array(
        [mt.simulate(link, WAVE, photons=32, time=t, extent=2.0, spacing=0.04).gain for t in times]
    )
    beta = 0.33 * 50.0 * 10.0 / (10.0 + 1.33 * 50.0)
    eps = beta * 0.05 * (2.0 * math.pi / 3.0) ** 2
    assert gain.var() / gain.mean() ** 2 == pytest.approx((1.0 - eps**2) ** -0.5 - 1.0, rel=2e-2)


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_interpolated_normals_weigh_reversed_light_as_light_from_the_air(normals):
    link = down(mt.AirLed(half_angle_deg=20.0), fov_deg=180.0).replace(water=mt.Water(b=0.0))
    mesh = WAVE.mesh(0.0, 4.0, 0.3)  # coarse, so that the normals differ from those of the facets
    forced = ForcedDetection(link, 32 * 256, 1, normals=normals, scattered="chains")
    aimed = forced.planner.aim_over(mesh)
    score = aimed.aim(0, 0, forced.drawer.whole(forced.unscattered()[0]))[0]
    shifts = score.reshape(32, -1).mean(axis=1)
    error = shifts.std(ddof=1) / math.sqrt(32)
    assert abs(shifts.mean() - aimed.direct_gains(0, 0).sum()) < 4.0 * error


# Totals, and the estimators against each other

TOTALS = {
    "D1_r0.05": down(radius=0.05),
    "D1_r0.25": down(),
    "D1_fov20_r0.25": down(fov_deg=20.0),
    "D1_d20_r0.05": down(radius=0.05, depth=20.0),
    "D1_d40_r0.05": down(radius=0.05, depth=40.0),
    "D2_r0.05": down(mt.AirLed(half_angle_deg=60.0), 0.05, fov_deg=180.0),
    "D2_r0.25": down(mt.AirLed(half_angle_deg=60.0), fov_deg=180.0),
    "D5_r0.25": down(BEAM, fov_deg=20.0),
    "D6_r0.25": down(fov_deg=120.0).replace(water=TURBID),
    "S1_r0.25": down(),
}


@pytest.mark.statistical
@pytest.mark.parametrize("name", TOTALS)
def test_totals_of_reversed_chains_of_another_program(name):
    wanted = REFERENCE["downlink_total"][name]
    found = mt.simulate(TOTALS[name], WAVE if name[0] == "S" else FlatSea(), photons=8192)
    error = math.hypot(found.gain_stderr, wanted["stderr"])
    assert error < 0.01 * wanted["value"]
    assert abs(found.gain - wanted["value"]) < 4.0 * error


LAYERS = mt.Water(layers=((0.0, 0.1, 0.02), (4.0, 0.1, 0.12), (20.0, 0.12, 0.05)))
WIDE = down(radius=1.0)
LINKS = {
    "flat": (WIDE, FlatSea()),
    "sinusoid": (WIDE, WAVE),
    "waves and tilts": (WIDE, sea_in_wind(13.0)),
    "bubbles and foam": (WIDE.in_wind(13.0), sea_in_wind(13.0)),
    "layers": (WIDE.replace(water=LAYERS), FlatSea()),
    "tilts": (
        down(
            mt.AirLed(tilt_deg=15.0, half_angle_deg=20.0),
            1.0, tilt_deg=20.0, tilt_azimuth_deg=90.0, fov_deg=90.0,
        ),
        sea_in_wind(5.0),
    ),
    "aside": (
        down(mt.AirLed(half_angle_deg=30.0), 1.5, position=(4.0, 2.0), fov_deg=180.0),
        sea_in_wind(8.0),
    ),
    "narrow beam": (down(mt.AirBeam(height=20.0, divergence_deg=0.5), 0.3), WAVE),
    "top hat": (down(mt.AirTopHatBeam(divergence_deg=8.0), 0.5), FlatSea()),
}  # fmt: skip


@pytest.mark.statistical
@pytest.mark.parametrize("name", LINKS)
@pytest.mark.thorough
@pytest.mark.slow_but("bubbles and foam", "narrow beam")
def test_forced_detection_agrees_with_analog_photons(name):
    link, sea = LINKS[name]
    mesh, _ = meshing.mesh_for(link, sea)
    forced = mt.simulate(link, mesh, photons=8192, threads=2)
    analog = mt.simulate(link, mesh, "analog", photons=2_400_000, threads=2)
    error = math.hypot(forced.gain_stderr, analog.gain_stderr)
    assert error < 0.005 * forced.gain  # that of both estimators together
    # 3.5 standard errors: all links agree by chance in 99.6 % of the cases
    assert abs(forced.gain - analog.gain) < 3.5 * error


@pytest.mark.parametrize("aside", [20.0, 50.0, 100.0])
@pytest.mark.thorough
@pytest.mark.slow_but("20.0")
def test_a_lamp_far_aside_needs_a_bounded_sea(aside):
    """The reach was 200 m: minutes for one gain. The time is in tests/benchmarks."""
    lamp = mt.AirLed(half_angle_deg=60.0)
    link = down(lamp, 0.05, position=(aside, 0.0), fov_deg=180.0)
    reach = crossing_reach(link)
    mesh, _ = meshing.mesh_for(link, sea_in_wind(5.0), reach=reach)
    assert reach < aside + 60.0
    assert len(mesh.faces) < 20_000 * (aside + 10.0)
    with catch_warnings():
        simplefilter("ignore")  # few paths, light reflected by the surface
        found = mt.simulate(link, mesh, threads=1)
    assert 0.0 < found.gain_stderr < 0.5 * found.gain


@pytest.mark.filterwarnings("ignore:receiver 0:UserWarning")
@pytest.mark.thorough
def test_a_lamp_close_to_the_water_reaches_a_receiver_aside():
    """The sea where its light crosses once ended before the receiver, and was refused."""
    link = down(mt.AirLed(height=0.226, half_angle_deg=30.0), depth=10.0, position=(0.0, 13.3))
    first = mt.simulate(link, FlatSea(), photons=8192, seed=1)
    other = mt.simulate(link, FlatSea(), photons=8192, seed=2, extent=30.0)
    assert first.gain > 5.0 * first.gain_stderr
    assert abs(first.gain - other.gain) < 3.9 * math.hypot(first.gain_stderr, other.gain_stderr)


@pytest.mark.statistical
@pytest.mark.thorough
def test_joined_photons_to_the_lamp_agree_with_chains():
    link = down(mt.AirLed(half_angle_deg=40.0), position=(6.0, 0.0), fov_deg=120.0)
    mesh, _ = meshing.mesh_for(link.in_wind(8.0), sea_in_wind(8.0), reach=crossing_reach(link))
    sea = TypicalSea.of_meshes([mesh])
    a, b = (
        ForcedDetection(link.in_wind(8.0), n, 1, sea=sea, scattered=how).evaluate(mesh)
        for how, n in (("chains", 8192), ("joined", 16384))
    )
    assert b.method == ["joined"]
    error = math.hypot(float(a.stderr[0]), float(b.stderr[0]))
    assert error < 0.03 * a.gain[0]
    assert abs(a.gain[0] - b.gain[0]) < 4.0 * error


@pytest.mark.statistical
def test_several_lamps_share_their_power():
    lamps = (mt.AirLed(power_mw=30.0), mt.AirLed(power_mw=70.0, position=(1.0, 0.0)))
    both = mt.simulate(down(lamps), FlatSea(), photons=4096)
    alone = [mt.simulate(down(lamp), FlatSea(), photons=4096) for lamp in lamps]
    expected = sum(w * r.gain for w, r in zip((0.3, 0.7), alone, strict=True))
    direct = sum(w * r.gain_ballistic for w, r in zip((0.3, 0.7), alone, strict=True))
    error = math.hypot(both.gain_stderr, alone[0].gain_stderr, alone[1].gain_stderr)
    assert both.gain_ballistic == pytest.approx(direct, rel=1e-6)
    assert abs(both.gain - expected) < 4.0 * error


# Reproducibility, arrivals, paths


@pytest.mark.thorough
def test_threads_and_the_order_of_receivers_change_no_digit():
    ends = [mt.WaterReceiver(), mt.WaterReceiver(position=(1.0, 0.0), depth=12.0, radius=0.2)]
    link = mt.Link(transmitter=mt.AirLed(half_angle_deg=20.0), receiver=tuple(ends))
    sea = sea_in_wind(5.0)
    one = mt.simulate(link, sea, photons=512, threads=1, extent=8.0, spacing=0.2)
    two = mt.simulate(link, sea, photons=512, threads=2, extent=8.0, spacing=0.2)
    turned = mt.simulate(
        link.replace(receiver=tuple(ends[::-1])), sea, photons=512, extent=8.0, spacing=0.2
    )
    assert (one.gain == two.gain).all()
    assert (one.gain == turned.gain[::-1]).all()


@pytest.mark.thorough
def test_arrivals_add_up_and_paths_run_from_the_lamp_to_the_receiver():
    link = down()
    found = mt.simulate(link, FlatSea(), photons=512, record=["arrivals"])
    assert found.arrivals.weight.sum() == pytest.approx(found.gain, rel=1e-9)
    assert (found.arrivals.air_path >= 4.99).all()
    assert (found.arrivals.water_path >= 9.99).all()
    first = mt.impulse_response(found).first_arrival
    assert first == pytest.approx((5.0 + 1.33 * 10.0) / 299_792_458.0, rel=1e-3)
    paths = mt.trace_paths(link, FlatSea(), 20, received_only=True)
    for vertex, what, n in zip(paths.vertex, paths.what, paths.length, strict=True):
        assert_allclose(vertex[0], [0.0, 0.0, 5.0], atol=1e-9)
        assert vertex[1, 2] == pytest.approx(0.0, abs=1e-6)
        assert what[1] == Vertex.SURFACE_IN
        assert (vertex[2:n, 2] < 0.0).all()
        assert vertex[n - 1, 2] == pytest.approx(-10.0)
        assert math.hypot(*vertex[n - 1, :2]) <= 0.25


def test_the_fates_of_analog_light_from_a_lamp_add_up():
    found = mt.simulate(down(), sea_in_wind(8.0), "analog", photons=20_000)
    assert sum(f.weight for f in found.fates.values()) == pytest.approx(1.0, abs=1e-12)


def test_tilted_lamps_shine_aside():
    link = down(position=(2.0, 0.0))
    straight = mt.simulate(link, FlatSea(), photons=256).gain
    towards = mt.simulate(link.replace("transmitter.tilt_deg", 10.0), FlatSea(), photons=256).gain
    away = link.replace(transmitter=mt.AirLed(tilt_deg=10.0, tilt_azimuth_deg=180.0))
    assert towards > 1.3 * straight > 2.0 * mt.simulate(away, FlatSea(), photons=256).gain


# Refusals


@pytest.mark.parametrize(
    ("link", "sea", "text"),
    [
        (down(mt.AirLed(height=0.3)), SWELL, r"^transmitter\.height: 0\.3 m.*crest"),
        (down(depth=0.3), sea_in_wind(13.0), r"^receiver\.depth: 0\.3 m.*trough"),
        (down(mt.AirBeam(divergence_deg=0.05)), FlatSea(), r"^transmitter: .*0\.05.*analog"),
        (down(fov_deg=0.05), FlatSea(), r"^receiver\.fov_deg: 0\.05.*analog"),
        (down(mt.AirBeam(waist=0.1)), FlatSea(), r"^transmitter: a radius.*analog"),
        (down().replace(physics="paper"), FlatSea(), r"^physics: snell.*fresnel.*fov.*analog"),
        (down().replace("physics.fresnel", "paper_both"), FlatSea(), r"^physics: fresnel"),
        (down().replace("physics.free_path", "local_c"), FlatSea(), r"^physics: free_path"),
        (mt.Link(transmitter=mt.Sun()), FlatSea(), r"^transmitter: sun.*in the water"),
        (
            mt.Link(receiver=(mt.WaterReceiver(), mt.Receiver())),
            FlatSea(),
            r"^receiver\[0\]: water-receiver.*in the air",
        ),
        (
            mt.Link(transmitter=(mt.AirLed(), mt.Led()), receiver=mt.WaterReceiver()),
            FlatSea(),
            r"^transmitter\[1\]: led.*in the air",
        ),
    ],
)
def test_links_without_a_reverse_problem_are_refused(link, sea, text):
    with pytest.raises(Refused, match=text):
        mt.simulate(link, sea, photons=32)


def test_kernels_are_compiled_once_for_both_directions():
    """An array that may be written to is another type, and half a dozen seconds of compilation."""
    mesh = FlatSea().mesh(extent=4.0, spacing=1.0)
    aimed = AimedChains(forced_link(mt.Link().mirrored()), mesh)
    upside_down, _ = aimed._mirrored
    assert typeof(upside_down) == typeof(aimed.surface)
