"""Movies have the requested frames, and the sea moves in them."""

import re
import subprocess
from itertools import pairwise
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

import meshtrace as mt
from meshtrace import viz
from meshtrace.fading import resolve_band
from meshtrace.surfaces import FlatSea, JonswapSea, MeshSequence, resolved_sea
from meshtrace.viz import show

LINK, SEA = mt.Link(), JonswapSea(wind_speed=13.0, fetch=30e3, seed=7)
TIMES = np.array([0.0, 0.5, 1.0])
GAIN = mt.GainSeries(
    along="time",
    coordinate=TIMES,
    gain=np.array([1e-5, 2e-5, 1.5e-5]),
    gain_stderr=np.full(3, 1e-7),
    gain_ballistic=np.zeros(3),
    mean_stderr=1e-7,
)


def frames_of(path, size=show.SIZE):
    """Decode a movie, shape (frames, height, width, 3)."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", path]
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-fps_mode", "passthrough", "-"]
    done = subprocess.run([*command, *raw], capture_output=True, check=True)
    return np.frombuffer(done.stdout, np.uint8).reshape(-1, *size[::-1], 3).astype(int)


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
@pytest.mark.thorough
@pytest.mark.slow_but(".gif")
def test_movies(tmp_path, suffix):
    seen = []
    path = viz.save_movie(
        LINK,
        SEA,
        TIMES,
        tmp_path / f"sea{suffix}",
        gain=GAIN,
        progress=seen.append,
        style=viz.SceneStyle(spacing=0.5),
    )
    frames = frames_of(path)
    assert len(frames) == 3
    assert seen == [1, 1, 1]
    scene, plot = frames[:, :, :800], frames[:, :, 830:]
    for part in (scene, plot):
        assert (np.abs(np.diff(part, axis=0)).sum(axis=3) > 60).mean(axis=(1, 2)).min() > 1e-3


def test_wrong_movies_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"path: .*allowed: a file name in \.mp4 or \.gif"):
        viz.save_movie(LINK, SEA, TIMES, tmp_path / "a.avi", gain=GAIN)
    with pytest.raises(ValueError, match=r"times: \[0.0\], allowed: two times"):
        viz.save_movie(LINK, SEA, [0.0], tmp_path / "a.gif", gain=GAIN)
    with pytest.raises(ValueError, match="gain: at other times"):
        viz.save_movie(LINK, SEA, TIMES + 1.0, tmp_path / "a.gif", gain=GAIN)
    with pytest.raises(ValueError, match=r"frame_rate: 0\.0"):
        viz.save_movie(LINK, SEA, TIMES, tmp_path / "a.gif", gain=GAIN, frame_rate=0.0)
    assert list(tmp_path.iterdir()) == []


def test_a_movie_shows_the_sea_of_its_series(tmp_path, monkeypatch):
    """An open band has all waves that make light fade, in the picture as in the series."""
    seen, compute = [], mt.time_series

    def stop(link, sea, **_options):
        seen.append(sea)
        raise StopAsyncIteration

    def series(link, sea, times, **options):
        seen.append(sea)
        return compute(link, sea, times, **options)

    monkeypatch.setattr(show, "scene", stop)
    monkeypatch.setattr("meshtrace.studies.series.time_series", series)
    wide = mt.Link(receiver=mt.Receiver(radius=0.5))
    with pytest.raises(StopAsyncIteration):
        viz.save_movie(wide, JonswapSea(), [0.0, 0.1], tmp_path / "a.gif", photons=64)
    assert seen == [resolve_band(wide, resolved_sea(5.0, fetch=30e3), "fading")] * 2


def test_a_frame_looks_the_surface_up_a_few_times(monkeypatch):
    """Each search takes milliseconds to set up: one for each cone took most of a frame."""
    calls, intersect = [], mt.EmbreeIntersector.intersect

    def counted(self, origins, directions):
        calls.append(len(origins))
        return intersect(self, origins, directions)

    monkeypatch.setattr(mt.EmbreeIntersector, "intersect", counted)
    viz.scene(mt.Link(), FlatSea(), style=viz.SceneStyle(off_screen=True)).close()
    assert 0 < len(calls) <= 20


def test_a_movie_of_meshes_from_files(tmp_path, monkeypatch):
    """A source of meshes has no `elevation`: the colour limit is 1.2 of the highest vertex."""
    limits = []

    def stop(link, sea, **options):
        limits.append(options["style"].color_limit)
        raise StopAsyncIteration

    for i, height in enumerate((0.1, 0.3, 0.2)):
        FlatSea(height=height).mesh(extent=25.0, spacing=5.0).to_trimesh().export(
            tmp_path / f"sea_{i}.ply"
        )
    sea = MeshSequence(str(tmp_path / "sea_*.ply"), frame_rate=2.0)
    monkeypatch.setattr(show, "scene", stop)
    with pytest.raises(StopAsyncIteration):
        viz.save_movie(LINK, sea, TIMES, tmp_path / "a.gif", gain=GAIN)
    assert limits == [pytest.approx(0.12)]


@pytest.mark.slow
def test_digits_of_the_gallery_are_those_of_their_time(tmp_path):
    """A coarse encoder leaves the digits of the frame before in the title: by 250 of 255 at 2.8."""
    script = Path(__file__).parents[2] / "docs" / "gallery" / "movie.py"
    quality = float(re.search(r"quality=([\d.]+)", script.read_text("utf-8")).group(1))
    times = np.arange(30) / 20.0
    gain = 1e-4 * (1.0 + 0.3 * np.sin(3.0 * times))
    series = mt.GainSeries("time", times, gain, 0.01 * gain, gain, 1e-7)
    width, height = show._SCENE_SIZE
    scene = np.full((height, width, 3), 180, np.uint8)
    drawn = list(show._beside_gain([scene] * len(times), series))
    path = tmp_path / "a.mp4"
    show._write_movie(path, drawn, len(drawn), show.writer_options(path, 20.0, quality), None)
    title = np.s_[60:85, 960:1200]
    changes = [np.abs(b[title].astype(int) - a[title]).max() for a, b in pairwise(drawn)]
    assert min(changes) > 150
    for shown, made in zip(frames_of(path), drawn, strict=True):
        assert np.abs(shown[title] - made[title]).max() < 150
