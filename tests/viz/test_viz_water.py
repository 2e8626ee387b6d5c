"""Water reflects sky and sun as it should, has its own colour, its short waves and its foam."""

import inspect
import math
from dataclasses import replace

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import TriangleMesh, viz
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.viz import scenes, show, style, water
from meshtrace.viz.water import WATER_BRIGHTNESS, SeaLight, foam_streaks, short_waves

SEA = JonswapSea(wind_speed=13.0, seed=7)
N = 1.33
SMALL = {"off_screen": True, "window_size": (480, 300), "spacing": 0.4}


def level(extent=20.0, n=81):
    """Return the points of a level sea, and their slopes."""
    x, y = np.meshgrid(*2 * (np.linspace(-extent, extent, n),), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)])
    return points, np.zeros((n * n, 2))


@pytest.mark.parametrize(("zenith", "azimuth"), [(30.0, 0.0), (45.0, 120.0), (20.0, -70.0)])
def test_glint_is_brightest_in_the_mirror_image_of_the_sun(zenith, azimuth):
    day = mt.Daylight(direct=1.4, diffuse=0.3, sun_zenith_deg=zenith, sun_azimuth_deg=azimuth)
    height, variance = 10.0, 0.002
    points, slopes = level()
    light = water.radiance(points, slopes, (0.0, 0.0, height), SeaLight(day), (variance, variance))
    away = height * math.tan(math.radians(zenith))
    mirror = away * np.array([math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))])
    np.testing.assert_allclose(points[np.argmax(light[:, 0]), :2], mirror, atol=0.6)


def test_the_default_sun_glitters_on_a_rough_sea_without_whitening_it():
    """From the place of the default camera: bright waves, hardly any without a colour."""
    mesh = SEA.mesh(extent=30.0, spacing=0.5)
    azimuth, elevation = np.radians([-68.0, 30.0])
    across = math.cos(elevation)
    eye = 120.0 * np.array(
        [across * math.cos(azimuth), across * math.sin(azimuth), math.sin(elevation)]
    )
    light = SeaLight.from_link(None, None, (SEA.wind_speed, 0.0))
    darkest = water.ShadedSea(mesh, light, texels=256).colors(tuple(eye)).min(axis=2)
    assert (darkest > 200).mean() > 0.02
    assert (darkest > 220).mean() < 0.01


def test_the_brightness_of_glint():
    """Cox and Munk at the mirror point: rho / (4 cos(theta) 2 pi s^2), for two roughnesses."""
    zenith = math.radians(40.0)
    day = mt.Daylight(direct=1.4, diffuse=0.3, sun_zenith_deg=40.0)
    points, slopes = np.array([[10.0 * math.tan(zenith), 0.0, 0.0]]), np.zeros((1, 2))
    rough, rougher = (
        water.radiance(points, slopes, (0.0, 0.0, 10.0), SeaLight(day), (v, v))
        for v in (0.01, 0.02)
    )
    inside = math.asin(math.sin(zenith) / N)
    r_s = math.sin(zenith - inside) / math.sin(zenith + inside)
    r_p = math.tan(zenith - inside) / math.tan(zenith + inside)
    rho = 0.5 * (r_s**2 + r_p**2)
    step = rho / (4.0 * math.cos(zenith) * 2.0 * math.pi) * (1.0 / 0.01 - 1.0 / 0.02)
    np.testing.assert_allclose(rough - rougher, math.pi * 1.4 / day.irradiance * step, rtol=1e-9)


def test_an_overcast_sky_seen_from_above():
    day = mt.Daylight(direct=0.0, diffuse=2.0, pattern="uniform")
    light = SeaLight(day, mt.Water(a=0.2, b=0.3))
    seen = water.radiance(np.zeros((1, 3)), np.zeros((1, 2)), (0.0, 0.0, 5.0), light, (0.0, 0.0))
    rho = ((N - 1.0) / (N + 1.0)) ** 2
    below = (1.0 - rho) * math.pi * WATER_BRIGHTNESS * light.upwelling
    np.testing.assert_allclose(
        seen[0], rho * water.CLOUD_RGB + below, rtol=2e-3
    )  # horizon cut at 1e-3


def test_clear_water_is_blue_and_harbour_water_is_not():
    red, green, blue = SeaLight(water=mt.Water.from_type("jerlov-I")).upwelling
    assert blue > 2.0 * green > 4.0 * red
    murky = SeaLight(water=mt.Water.from_type("petzold-harbour", 514.0)).upwelling
    assert murky[1] > murky[2]


@pytest.mark.parametrize("direction", [0.0, 50.0])
def test_short_waves_have_the_variances_of_the_sea(direction):
    variances = (0.03, 0.02)
    slopes, rest = short_waves(4.0, 256, variances, 20.0, direction)
    turn = math.radians(direction)
    x, y = np.moveaxis(slopes.astype(float), -1, 0)
    along = x * math.cos(turn) + y * math.sin(turn)
    across = y * math.cos(turn) - x * math.sin(turn)
    # 1e4 independent waves and more, fewer of the longest: within 5 %
    for component, left, total in zip((along, across), rest, variances, strict=True):
        assert 0.0 < left < total
        assert component.var() + left == pytest.approx(total, rel=0.05)
    later, _ = short_waves(4.0, 256, variances, 20.0, direction, time=0.5)
    assert later.std() == pytest.approx(slopes.std(), rel=0.05)
    assert abs(np.corrcoef(later.ravel(), slopes.ravel())[0, 1]) < 0.5


def test_short_waves_travel_downwind():
    """The wave of one wavenumber is where its phase speed has taken it."""
    size, n, m, time = 1.0, 64, 8, 0.03
    k = 2.0 * math.pi * m / size
    first, later = (
        np.fft.fft2(short_waves(size, n, (0.01, 0.01), 40.0, time=t)[0][..., 0])[m, 0]
        for t in (0.0, time)
    )
    speed = math.sqrt(9.81 / k + 7.4e-5 * k)
    assert np.angle(later / first) == pytest.approx(-k * speed * time, abs=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.002, 0.11, 0.5])
def test_foam_covers_its_share(share):
    streaks = foam_streaks(10.0, 256, 0.0).ravel()
    heights = np.sin(np.arange(len(streaks)))
    cover = water.foam_cover(streaks, heights, share)
    assert (cover > 0.5).mean() == pytest.approx(share, abs=1e-4)
    assert cover.min() >= 0.0
    assert cover.max() <= 1.0
    if share == 0.11:
        assert heights[cover > 0.5].mean() > 0.2  # rather on crests


def test_foam_is_drawn_out_along_the_wind():
    streaks = foam_streaks(10.0, 256, 90.0)
    along = np.mean(streaks * np.roll(streaks, 8, axis=1))
    across = np.mean(streaks * np.roll(streaks, 8, axis=0))
    assert along > across + 0.2


def test_colours_are_those_of_a_screen_and_the_same_again():
    mesh = SEA.mesh(1.0, extent=8.0, spacing=0.4)
    light = SeaLight.from_link(mt.Link().in_wind(13.0), None, (13.0, 0.0))
    assert light.foam == pytest.approx(2.95e-6 * 13.0**3.52)  # Monahan and O'Muircheartaigh
    seen = [
        water.ShadedSea(mesh, light, 4.0, time, texels=64).colors((5.0, -30.0, 8.0))
        for time in (1.0, 1.0, 1.3)
    ]
    assert seen[0].shape == (64, 64, 3)
    assert seen[0].dtype == np.uint8
    assert seen[0].std() > 10.0
    np.testing.assert_array_equal(seen[0], seen[1])
    assert (seen[0] != seen[2]).mean() > 0.5
    dark, white = water.screen_colors(np.array([[0.0] * 3, [1e3] * 3]))
    assert (dark.tolist(), white.tolist()) == ([0] * 3, [255] * 3)


def test_grids_are_found_and_refined():
    mesh = SEA.mesh(0.0, extent=3.0, spacing=1.0)
    assert water.grid_shape(mesh) == (7, 7)
    fan = TriangleMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    assert water.grid_shape(fan) is None
    assert water.ShadedSea(fan, SeaLight(), texels=16).colors((0.0, 0.0, 9.0)).shape == (4, 3)
    assert water.ShadedSea(mesh, SeaLight(), texels=13).colors((0.0, 0.0, 9.0)).shape == (13, 13, 3)


def test_the_colours_follow_the_camera_and_the_sun():
    def shot(azimuth, turn=None):
        day = mt.Daylight(direct=1.4, diffuse=0.3, sun_zenith_deg=50.0, sun_azimuth_deg=azimuth)
        plotter = viz.scene(mt.Link(), SEA, daylight=day, style=viz.SceneStyle(**SMALL))
        if turn is not None:
            viz.look(plotter, turn)
        texture = plotter.actors["surface"].texture.to_array()
        plotter.close()
        return texture.astype(float).mean()

    behind = shot(112.0)  # the camera looks towards it
    assert behind > 1.15 * shot(-68.0)
    assert behind > 1.15 * shot(112.0, turn=112.0)


def test_the_ruler_is_level_with_the_lamp():
    plotter = viz.scene(mt.Link(transmitter=mt.Led(depth=10.0)), SEA, style=viz.SceneStyle(**SMALL))
    marks = {text: point for point, text, _ in plotter.texts}
    matrix = plotter.camera.GetCompositeProjectionTransformMatrix(480 / 300, -1, 1)

    def height(point):
        _, y, _, w = matrix.MultiplyPoint((*point, 1.0))
        return y / w

    for mark, place in (("-10", (0.0, 0.0, -10.0)), ("4", (0.0, 0.0, 4.0))):
        assert height(marks[mark]) == pytest.approx(height(place), abs=1e-9)
    before = len(plotter.texts)
    behind = 2.0 * np.array(plotter.camera.position) - plotter.camera.focal_point
    viz.add_labels(plotter, [behind], ["behind the camera"])
    assert len(plotter.texts) == before
    plotter.close()


def test_captions_state_link_sea_and_gain():
    gain = mt.simulate(mt.Link(), FlatSea(), photons=64)
    text = scenes.caption(mt.Link(), SEA, 2.5, gain)
    assert text == (
        "LED at depth 10 m to receiver at height 5 m; JONSWAP sea, wind 13 m/s, seed 7, "
        f"t = 2.50 s, Hs 1.3 m; gain {gain.gain:.2e} ± {gain.gain_stderr:.0e}"
    )
    # mostly noise: a reader would take it for the gain
    noisy = replace(gain, gain_stderr=0.2 * gain.gain)
    dark = replace(gain, gain=0.0, gain_stderr=0.0)
    assert "gain" not in scenes.caption(mt.Link(), SEA, 2.5, noisy)
    assert "gain" not in scenes.caption(mt.Link(), SEA, 2.5, dark)
    assert scenes.caption(mt.Link(), SEA, 2.5, dark).endswith("; no light received")
    down = scenes.caption(mt.Link().mirrored(), FlatSea(), 0.0, None)
    assert down.endswith("at depth 10 m; flat sea")
    assert "at height 5 m" in down
    sun = scenes.caption(mt.Link(transmitter=mt.link.Sun()), FlatSea(), 0.0, None)
    assert sun == "sun to receiver at height 5 m; flat sea"
    assert scenes.caption(None, SEA.mesh(0.0, 2.0, 1.0), 0.0, None) == "mesh"


def test_movies_last_ten_seconds_at_natural_speed():
    frames = inspect.signature(viz.view).parameters["frames"].default
    assert (frames / show.FRAME_RATE, show.FRAME_RATE) == (10.0, 30.0)
    assert show.natural_rate(np.arange(300) / 30.0) == pytest.approx(30.0)
    with pytest.raises(ValueError, match=r"times: .*increasing"):
        show.natural_rate(np.zeros(2))


def test_rays_stand_out_from_water_and_air():
    """Contrast of luminance by WCAG 2, (L1 + 0.05) / (L2 + 0.05), of 2 and more."""
    from matplotlib.colors import to_rgb

    from meshtrace.viz.style import DEEP, DUSK, NIGHT, SHALLOW

    def luminance(color):
        c = np.array(to_rgb(color))
        return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [
            0.2126, 0.7152, 0.0722
        ]  # fmt: skip

    def contrast(a, b):
        low, high = sorted((luminance(a), luminance(b)))
        return (high + 0.05) / (low + 0.05)

    received, landed, ended = style.FATE_COLORS.values()
    for color in (received, landed):
        assert min(contrast(color, other) for other in (DUSK, NIGHT, SHALLOW, DEEP)) > 2.0
    assert contrast(ended, DEEP) > 2.0
