"""Pictures and movies of the irradiance under a moving sea."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import viz
from meshtrace.errors import Refused
from meshtrace.surfaces import SinusoidalSea

SEA = SinusoidalSea(amplitude=0.02, wavelength=0.8)
DAY = mt.Daylight(direct=1.0, diffuse=0.0, sun_zenith_deg=0.0)


@pytest.fixture(scope="module")
def series():
    options = {"depths": [1.0, 3.0], "times": [0.0, 0.1, 0.2], "photons": 1000}
    return mt.irradiance_series(SEA, DAY, patch=(0.6, 0.05), water=mt.Water(b=0.0), **options)


def test_a_picture_shows_the_bright_stripes_of_a_wave(series, tmp_path):
    from imageio.v2 import imread

    picture = imread(viz.save_irradiance(series, tmp_path / "a.png", depths=[1.0]))
    height, width = picture.shape[:2]
    bright = picture[height // 3 : 2 * height // 3, :, :3].sum(axis=(0, 2))
    inside = bright[width // 4 : width // 2].astype(float)
    wanted = series.pattern[0, 0].mean(axis=1)
    assert np.ptp(wanted) > 0.2 * wanted.mean()
    assert np.ptp(inside) > 0.2 * inside.max()


def test_a_movie_has_a_frame_for_each_time(series, tmp_path):
    from imageio.v3 import imread

    steps = []
    frames = imread(viz.save_irradiance(series, tmp_path / "a.gif", progress=steps.append))
    assert sum(steps) == len(frames) == 3
    assert not np.array_equal(frames[0], frames[2])


@pytest.mark.thorough
def test_a_movie_for_browsers(series, tmp_path):
    from imageio_ffmpeg import count_frames_and_secs

    path = viz.save_irradiance(series, tmp_path / "a.mp4", frame_rate=10.0)
    frames, seconds = count_frames_and_secs(str(path))
    assert frames == 3
    assert seconds == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"depths": [2.0]}, r"depths: 2.0, allowed: depths of the series: \[1.0, 3.0\]"),
        ({"frame_rate": 0.0}, "frame_rate: 0.0, allowed: > 0 frames per second"),
        ({"path": "a.txt"}, "path: .*, allowed: a file name in .png, .mp4 or .gif"),
    ],
)
def test_refusals(series, options, text, tmp_path):
    path = tmp_path / options.pop("path", "a.gif")
    with pytest.raises(Refused, match=text):
        viz.save_irradiance(series, path, **options)


def test_a_series_without_a_patch_has_no_picture(tmp_path):
    bare = mt.irradiance_series(SEA, DAY, depths=[1.0], times=[0.0], photons=1000)
    with pytest.raises(Refused, match="series: no pattern, allowed: one with a patch"):
        viz.save_irradiance(bare, tmp_path / "a.png")
