"""Pictures and movies of the light pattern."""

import numpy as np
import pytest
from PIL import Image
from test_viz_movie import frames_of

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.viz import show

SHARP = mt.Link(physics={"unresolved": "none"})
SEA = JonswapSea(wind_speed=5.0, omega_max=8.0, seed=3)
SMALL = {"extent": 1.0, "step": 0.05}


@pytest.mark.thorough
def test_a_picture(tmp_path):
    path = viz.save_light(SHARP, SEA, tmp_path / "light.png", **SMALL)
    with Image.open(path) as picture:
        assert picture.size[0] / picture.size[1] == pytest.approx(
            show.LIGHT_SIZE[0] / show.LIGHT_SIZE[1], abs=0.01
        )
        colors = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    assert len(np.unique(colors, axis=0)) > 1000


@pytest.mark.thorough
@pytest.mark.parametrize("wind", [3.0, 8.0])
def test_the_pattern_of_a_link_file_is_no_flat_square(tmp_path, wind):
    """The waves of a mean gain are longer than the pattern, which would be flat."""
    link = mt.Link(bubbles=mt.HallNovarini(wind_speed=wind))
    case = mt.Scenario(wind_speed=wind, link=link, surface=JonswapSea(wind_speed=wind)).case()
    path = viz.save_light(case.link, case.surface, tmp_path / "light.png", step=0.05, extent=2.0)
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("L"), float)
    height, width = pixels.shape
    rows = slice(round(0.2 * height), round(0.8 * height))
    for left, right in ((0.1, 0.38), (0.6, 0.88)):  # within the sea, and within its light
        assert pixels[rows, round(left * width) : round(right * width)].std() > 10.0


@pytest.mark.thorough
def test_a_picture_shows_the_sea_of_its_time(tmp_path):
    seas = []
    for time in (0.0, 3.0):
        path = viz.save_light(SHARP, SEA, tmp_path / f"{time}.png", [time], **SMALL)
        with Image.open(path) as picture:
            pixels = np.asarray(picture.convert("RGB"), float)
        seas.append(pixels[80:-80, 60 : pixels.shape[1] // 2 - 120])
    assert (np.abs(seas[1] - seas[0]).sum(axis=2) > 30).mean() > 0.1


@pytest.mark.thorough
def test_a_movie_in_which_light_and_sea_move(tmp_path):
    seen = []
    path = viz.save_light(
        SHARP, SEA, tmp_path / "light.mp4", [0.0, 0.1, 0.2], **SMALL, progress=seen.append
    )
    frames = frames_of(path, show.LIGHT_SIZE)
    assert len(frames) == 3
    assert seen == [1, 1, 1]
    half = show.LIGHT_SIZE[0] // 2
    for part in (frames[:, 80:-80, 60 : half - 120], frames[:, 80:-80, half + 60 : -120]):
        assert (np.abs(np.diff(part, axis=0)).sum(axis=3) > 30).mean(axis=(1, 2)).min() > 1e-2


@pytest.mark.thorough
def test_view_writes_the_pattern_beside_no_window(tmp_path):
    written = viz.view(
        SHARP, SEA, pattern=tmp_path / "light.png", style=viz.SceneStyle(extent=1.0), frames=2
    )
    assert written == [tmp_path / "light.png"]
    with pytest.raises(ValueError, match="pattern: of a mesh, allowed: a link over a sea"):
        viz.view(None, FlatSea().mesh(extent=2.0, spacing=1.0), pattern=tmp_path / "a.png")


def test_wrong_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"path: .*allowed: a file name in \.png, \.mp4 or \.gif"):
        viz.save_light(SHARP, SEA, tmp_path / "a.avi", [0.0, 1.0])
    with pytest.raises(ValueError, match=r"times: shape \(1,\)"):
        viz.save_light(SHARP, SEA, tmp_path / "a.mp4", [0.0])
    assert list(tmp_path.iterdir()) == []
