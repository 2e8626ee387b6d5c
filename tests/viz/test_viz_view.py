"""Files of `viz.view`, the function behind the command line."""

import pytest
from PIL import Image

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(seed=7)


@pytest.mark.slow
def test_view_writes_every_kind_of_file(tmp_path):
    names = {"screenshot": "a.png", "html": "a.html", "movie": "a.gif"}
    asked = {kind: tmp_path / name for kind, name in names.items()}
    written = viz.view(
        mt.Link(),
        SEA,
        paths=None,
        frames=2,
        style=viz.SceneStyle(spacing=0.5),
        title="sea",
        **asked,
    )
    assert sorted(written) == sorted(asked.values())
    with Image.open(asked["screenshot"]) as image:
        assert image.size == (1600, 1000)
    assert "<title>sea</title>" in asked["html"].read_text()
    with Image.open(asked["movie"]) as image:
        assert image.n_frames == 2


def test_view_of_a_mesh(tmp_path):
    mesh = SEA.mesh(extent=5.0, spacing=0.5)
    assert viz.view(None, mesh, screenshot=tmp_path / "a.png") == [tmp_path / "a.png"]
    with pytest.raises(ValueError, match="movie: of a mesh"):
        viz.view(None, mesh, movie=tmp_path / "a.gif")


def test_view_of_a_sea_without_a_link(tmp_path):
    style = viz.SceneStyle(off_screen=True, spacing=0.5, window_size=(320, 200))
    plotter = viz.scene(None, SEA, style=style)
    assert plotter.caption == "JONSWAP sea, wind 5 m/s, seed 7, t = 0.00 s, Hs 0.54 m"
    assert plotter.stage.half == 20.0
    # the waves lie on the stage
    heights = SEA.mesh(extent=20.0, spacing=0.5).vertices[:, 2]
    assert plotter.stage.bottom < heights.min() < heights.max() < plotter.stage.top


def test_the_caption_has_the_gain_of_run(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from meshtrace.cli import app

    texts = []
    monkeypatch.setattr("meshtrace.viz.scenes.add_caption", lambda _, text: texts.append(text))
    link = tmp_path / "link.toml"
    link.write_text("[run]\nphotons = 640\nseed = 5\n[sea]\nspacing = 0.5\n")
    picture = ["--screenshot", str(tmp_path / "a.png"), "--paths", "10"]
    CliRunner().invoke(app, ["view", str(link), *picture], catch_exceptions=False)
    expected = mt.Scenario.load(link).simulate()
    assert texts[0].endswith(f"gain {expected.gain:.2e} ± {expected.gain_stderr:.0e}")


def test_view_needs_a_display_for_a_window(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ValueError, match="view: no display"):
        viz.view(mt.Link(), SEA)
    monkeypatch.setenv("DISPLAY", ":4242")  # nobody answers there
    with pytest.raises(ValueError, match="view: no display"):
        viz.view(mt.Link(), SEA)


def test_the_sea_of_a_link_file_lies_under_its_daylight():
    from meshtrace.cli.view import _of_scenario
    from meshtrace.scenario import Scenario

    bright = Scenario.from_toml("[daylight]\ndirect = 1.0\ndiffuse = 0.5\n")
    assert _of_scenario(bright)["daylight"] == bright.daylight
    assert bright.daylight.direct == 1.0
    assert _of_scenario(Scenario.from_toml(""))["daylight"] is None
