"""The scene: its parts are those of the link and the sea, and only changed ones are sent."""

import numpy as np
import pytest
import trimesh
from scipy.stats import norm

import meshtrace as mt
from meshtrace.apps.explorer import controls, scenario_of, stages
from meshtrace.apps.explorer.scene import LiveScene
from meshtrace.scenario import Scenario
from meshtrace.viz.live import light_color, segments

STATE = controls.State(Scenario.from_toml(""))


@pytest.fixture
def scene():
    return LiveScene(STATE)


def points(scene, name="points"):
    return np.frombuffer(scene.parts["sea"][name], np.float32).reshape(-1, 3)


def test_the_sea_is_that_of_the_model(scene):
    state = STATE.moved({"wind": 9.0}).at(1.5)
    scene.update(state)
    sea, stage = state.scenario.surface, scene.stage
    mesh = sea.mesh(1.5, stage.half, 2 * stage.half / 120, center=stage.center)
    np.testing.assert_allclose(points(scene), mesh.vertices, atol=1e-6)
    np.testing.assert_allclose(points(scene, "normals"), mesh.vertex_normals, atol=1e-6)
    faces = np.frombuffer(scene.parts["faces"], np.uint32).reshape(-1, 3)
    np.testing.assert_array_equal(faces, mesh.faces)
    ring = points(scene, "ring")
    assert len(ring) == 4 * 120
    assert np.abs(ring[:, :2]).max(axis=1) == pytest.approx(stage.half, rel=1e-6)
    x, y = ring[:, :2].T
    assert (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0.0  # anticlockwise


def test_the_water_ends_at_the_edge_of_any_mesh(tmp_path):
    angle = np.radians(np.arange(0, 360, 10))
    rim = 30.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    faces = [[0, i, i % 36 + 1] for i in range(1, 37)]
    disk = trimesh.Trimesh(np.vstack([[0.0, 0.0, 0.0], rim]), faces)
    disk.export(tmp_path / "disk.stl")
    scenario = Scenario.from_toml("sea.mesh = 'disk.stl'", folder=tmp_path)
    ring = points(LiveScene(controls.State(scenario)), "ring")
    assert len(ring) == 36
    assert np.hypot(*ring[:, :2].T) == pytest.approx(30.0, rel=1e-6)


def test_only_parts_that_changed_are_sent(scene):
    assert set(scene.changes()) >= {"stage", "faces", "sea", "look", "link", "time"}
    scene.update(STATE)
    assert scene.changes() == {}
    scene.update(STATE.moved({"depth": 10.5}))
    assert set(scene.changes()) == {"stage", "link"}
    scene.update(STATE.moved({"depth": 10.5, "wind": 6.0}))
    assert set(scene.changes()) == {"sea", "look"}
    scene.update(STATE.moved({"depth": 10.5, "wind": 6.0}).at(0.7), running=True)
    assert set(scene.changes()) == {"sea", "time"}


def test_a_link_frames_its_state(scene):
    """A link to a smaller state once kept the camera of the state at the start."""
    before = scene.parts["stage"]["framing"]
    scene.update(STATE.moved({"depth": 8.0}))
    assert scene.parts["stage"]["framing"] == before
    scene.frame_anew()
    scene.update(STATE.moved({"depth": 7.5}))
    assert scene.parts["stage"]["framing"] == before + 1


def test_time_moves_the_waves_alone(scene):
    sea = points(scene).copy()
    scene.update(STATE.at(0.7), running=True)
    moved = points(scene)
    np.testing.assert_array_equal(moved[:, :2], sea[:, :2])
    assert np.abs(moved[:, 2] - sea[:, 2]).max() > 0.01
    flat = np.array(scene.profile())
    nearest = moved[np.hypot(*moved.T[:2]).argmin(), 2]
    np.testing.assert_allclose(np.interp(0.0, *flat.T), nearest, atol=1e-3)


@pytest.mark.parametrize("fetch", [2.0, 30.0, 1000.0])
def test_short_waves_are_drawn_at_every_fetch(scene, fetch):
    """Their slopes and the rest have the variance of all waves that the mesh leaves out."""
    scene.update(STATE.moved({"fetch": fetch, "wind": 8.0}))
    tile = scene.parts["look"]["waves"]
    pixels = np.frombuffer(tile["bytes"], np.uint8).reshape(tile["n"], tile["n"], 4) / 255.0
    slopes = (pixels[..., :2] - 0.502) / 0.498 * tile["scale"]
    drawn = slopes.reshape(-1, 2).var(axis=0)
    mesh = scene._drawn
    expected = np.add(*mesh.unresolved.vertex)
    assert drawn.sum() + sum(tile["rest"]) == pytest.approx(expected, rel=0.05)
    assert drawn.sum() > 0.3 * expected
    np.testing.assert_allclose(
        pixels[..., 2].mean() * tile["scale"] ** 2, (slopes**2).sum(axis=-1).mean(), rtol=0.05
    )


def test_foam_covers_its_share(scene):
    state = STATE.moved({"wind": 14.0})
    scene.update(state)
    tile = scene.parts["look"]["waves"]
    streaks = np.frombuffer(tile["bytes"], np.uint8)[3::4] / 255.0 * 8.0 - 4.0
    share = 2.95e-6 * 14.0**3.52  # Monahan and O'Muircheartaigh (1980)
    assert scene.parts["look"]["foam"] == pytest.approx(1.1 * norm.ppf(1.0 - share))
    assert (streaks > norm.ppf(1.0 - share)).mean() == pytest.approx(share, rel=0.5)


def test_the_block_holds_two_waves_of_the_peak_and_says_what_the_sea_is(scene):
    """At 3 and 15 m/s the sea once looked alike, in a block of 20 m."""
    for wind, half in ((3.0, 11.3), (15.0, 34.3)):
        moved = STATE.moved({"wind": wind})
        scene.update(moved)
        assert scene.stage.half == pytest.approx(half, rel=0.03)
        views = scene.views(moved)
        side = views["side"]["frame"]
        assert side["x1"] - side["x0"] == pytest.approx(18.6)
    assert views["sea"] == "waves Hs 1.5 m, Tp 4.7 s, foam 4.1 % by Monahan (22 % in the gain)"
    assert not scene.parts["look"]["foam"] > 2.0


def test_the_sky_is_that_of_the_state(scene):
    night = scene.parts["look"]
    assert night["direct"] == 0.0
    scene.update(STATE.moved({"light": "clear", "sun": 50.0}))
    day = scene.parts["look"]
    light = Scenario.from_toml('[daylight]\nmodel = "clear"\nsun_zenith_deg = 50').daylight
    assert day["sun"] == pytest.approx(light.sun)
    assert day["direct"] == pytest.approx(light.direct / light.irradiance)
    assert min(day["tint"]) > 10.0 * max(night["tint"])
    scene.update(STATE.moved({"light": "clear", "sun": 80.0}))
    low = scene.parts["look"]  # its bright horizon would be white
    assert 0.1 * max(day["tint"]) < max(low["tint"]) < 0.5 * max(day["tint"])
    scene.update(STATE.moved({"light": "moon"}))
    assert max(night["tint"]) < max(scene.parts["look"]["tint"]) < min(day["tint"])


def test_turbid_water_is_dark_at_night(scene):
    """It once outshone the beam."""
    clear = scene.parts["look"]
    scene.update(STATE.moved({"water": "petzold-harbour", "wavelength": 514.0}))
    turbid, link = scene.parts["look"], scene.parts["link"]
    assert max(turbid["upwelling"]) > 5.0 * max(clear["upwelling"])
    light = [np.multiply(look["inside"], look["upwelling"]).max() for look in (clear, turbid)]
    assert light[1] < 2.0 * light[0]
    assert link["scattering"] == pytest.approx(1.824)
    assert link["extinction"] - link["scattering"] < link["loss"] < 0.5 * link["extinction"]


def test_lamp_and_receiver_are_where_the_link_has_them(scene):
    moves = {"depth": 12.0, "lamp_x": -1.0, "height": 7.0, "offset_y": 2.0, "tilt": 10.0}
    scene.update(STATE.moved(moves))
    link = scene.parts["link"]
    lamp, receiver = link["lamps"][0], link["receivers"][0]
    assert lamp["at"] == (-1.0, 0.0, -12.0)
    assert lamp["place"][:3] == [-1.0, 0.0, -12.0]
    assert receiver["place"] == (0.0, 2.0, 7.0)
    power, tangent, *_ = lamp["shape"]
    assert np.cos(np.radians(10.0)) ** power == pytest.approx(0.5)
    assert np.cos(np.arctan(tangent)) ** power == pytest.approx(0.03)
    assert link["plane"] == 7.0
    assert link["extinction"] == pytest.approx(0.151)


def test_the_beam_of_a_lamp_in_the_air_is_bent():
    """From its image the same circle of the still sea is lit, at the angle of refraction."""
    state = controls.State(scenario_of(mt.Link().mirrored(), STATE.scenario.surface))
    scene = LiveScene(state.moved({"lamp_x": 1.0, "lamp": "top hat", "half_angle": 20.0}))
    link = scene.parts["link"]
    lamp = link["lamps"][0]
    assert lamp["at"] == (1.0, 0.0, 5.0)
    narrow = np.arccos(lamp["axis"][3])
    assert np.sin(narrow) == pytest.approx(np.sin(np.radians(20.0)) / 1.33)
    x, _, z, air = lamp["place"]
    assert (x, air) == (1.0, 1.0)
    assert z * np.tan(narrow) == pytest.approx(5.0 * np.tan(np.radians(20.0)))
    assert link["plane"] == -10.0
    assert link["carried"][0][0] == (1.0, 0.0, 5.0)


def test_the_colour_is_that_of_the_wavelength():
    assert np.argmax(light_color(470.0)) == 2
    assert np.argmax(light_color(532.0)) == 1
    assert np.argmax(light_color(640.0)) == 0


def test_rays_run_from_the_lamp_to_the_aperture(scene):
    paths = next(stages.rays(STATE, lambda *_: None))
    found = segments(paths)
    assert len(found) == (paths.length - 1).sum()
    assert found[:, :6].reshape(-1, 2, 3)[..., 2].min() == pytest.approx(-10.0, abs=0.05)
    assert found[:, :6].reshape(-1, 2, 3)[..., 2].max() == pytest.approx(5.0, abs=0.05)
    assert found[:, 6].sum() == (paths.length - 1)[paths.length > 3].sum()
    scene.show_rays(paths)
    assert len(scene.parts["rays"]) == found.nbytes
    scene.show_rays(None)
    assert scene.parts["rays"] == b""


def test_the_view_is_framed_anew_only_with_the_size_of_the_stage(scene):
    framing = lambda: scene.parts["stage"]["framing"]  # noqa: E731
    before = framing()
    scene.update(STATE.moved({"depth": 10.5}))
    assert framing() == before
    scene.update(STATE.moved({"depth": 30.0}))
    assert framing() > before


def test_a_move_of_the_link_leaves_the_sea_in_its_place(scene):
    sea, stage = points(scene), scene.stage
    scene.update(STATE.moved({"depth": 11.0, "height": 5.5}))
    np.testing.assert_array_equal(points(scene), sea)
    assert (scene.stage.center, scene.stage.half) == (stage.center, stage.half)
    assert scene.parts["stage"]["bottom"] < stage.bottom
    scene.update(STATE.moved({"wind": 9.0}))
    assert np.abs(points(scene)[:, 2]).max() > 1.2 * np.abs(sea[:, 2]).max()
    scene.update(STATE.moved({"depth": 60.0}))
    assert scene.stage.half > 1.25 * stage.half
    assert np.abs(points(scene)[:, 0]).max() == pytest.approx(scene.stage.half, rel=1e-6)


def test_bodies_on_the_stage_are_sent_once(tmp_path):
    trimesh.creation.box((2.0, 2.0, 2.0)).export(tmp_path / "box.ply")
    text = """objects = [{ mesh = "box.ply", position = [1, 0, -8] },
                         { mesh = "box.ply", position = [900, 0, -8], reflection = "mirror" }]"""
    scene = LiveScene(controls.State(Scenario.from_toml(text, folder=tmp_path)))
    near, far = scene.changes()["bodies"]
    corners = np.frombuffer(near["bytes"], np.float32).reshape(-1, 3, 3)
    assert len(corners) == 12
    np.testing.assert_allclose(corners.min(axis=(0, 1)), (0.0, -1.0, -9.0))
    np.testing.assert_allclose(corners.max(axis=(0, 1)), (2.0, 1.0, -7.0))
    assert not far["bytes"]
    assert near["color"] != far["color"]
    assert "bodies" not in scene.changes()
