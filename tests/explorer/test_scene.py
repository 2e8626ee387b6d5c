"""The scene: its parts stay, and their points are those of the link and the sea."""

import gc

import numpy as np
import pytest
from vtkmodules.vtkCommonCore import vtkObject

from meshtrace.explorer import stages
from meshtrace.explorer.controls import State
from meshtrace.explorer.scene import LiveScene
from meshtrace.scenario import Scenario
from meshtrace.viz.style import water_map

STATE = State(Scenario.from_toml(""))


@pytest.fixture
def scene():
    scene = LiveScene(STATE)
    yield scene
    scene.close()


def points(scene, name):
    return np.asarray(scene._parts[name].points)


def test_parts_and_actors_stay(scene):
    before = {name: (actor, actor.mapper.dataset) for name, actor in scene._actors.items()}
    scene.update(STATE.moved({"depth": 13.0, "wind": 9.0, "offset_x": 2.0}))
    scene.show_rays(next(stages.rays(STATE, lambda *_: None)))
    after = {name: (actor, actor.mapper.dataset) for name, actor in scene._actors.items()}
    assert list(before) == list(after)
    for name in before:
        assert before[name][0] is after[name][0]
        assert before[name][1] is after[name][1], name


def test_the_sea_is_that_of_the_model(scene):
    state = STATE.moved({"wind": 9.0}).at(1.5)
    scene.update(state)
    x, _, z = points(scene, "sea").T.astype(float)
    sea = state.scenario.surface
    mesh = sea.mesh(1.5, scene.stage.half, 2 * scene.stage.half / 120, center=scene.stage.center)
    np.testing.assert_allclose(z, mesh.vertices[:, 2], atol=1e-6)
    assert np.abs(x).max() == pytest.approx(scene.stage.half, rel=1e-6)
    assert scene.elevation_range[0] <= z.min() < z.max() <= scene.elevation_range[1]


def test_time_moves_the_waves_alone(scene):
    sea, lamp = points(scene, "sea").copy(), points(scene, "lamp").copy()
    cells = np.asarray(scene._parts["sea"].faces).copy()
    assert scene.update(STATE.at(0.7), running=True) is False
    moved = points(scene, "sea")
    np.testing.assert_array_equal(moved[:, :2], sea[:, :2])
    assert np.abs(moved[:, 2] - sea[:, 2]).max() > 0.01
    np.testing.assert_array_equal(points(scene, "lamp"), lamp)
    np.testing.assert_array_equal(scene._parts["sea"].faces, cells)
    flat = np.array(scene.profile())
    np.testing.assert_allclose(np.interp(0.0, *flat.T), moved[np.hypot(*moved.T[:2]).argmin(), 2],
                               atol=1e-3)  # fmt: skip


def tints(scene):
    return np.asarray(scene._parts["sea"].point_data["tint"]).astype(float)


def test_daylight_colours_the_sea_in_place(scene):
    """Elevation without light, sky and glint by day, with the same actor."""
    sea, actor = points(scene, "sea"), scene._actors["sea"]
    low, high = scene.elevation_range
    np.testing.assert_allclose(
        tints(scene), 255.0 * water_map()((sea[:, 2] - low) / (high - low))[:, :3], atol=3.0
    )
    assert actor.prop.diffuse > 0.0
    assert not scene.shows_daylight
    dark = tints(scene).copy()
    scene.update(STATE.moved({"light": "clear"}))
    assert scene.shows_daylight
    assert scene._actors["sea"] is actor
    assert actor.prop.diffuse == 0.0  # the colours are those that the camera sees
    day = tints(scene).copy()
    assert day.shape == dark.shape
    assert np.abs(day - dark).mean() > 10.0
    scene.update(STATE.moved({"light": "clear"}).at(0.7), running=True)
    assert np.abs(tints(scene) - day).mean() > 1.0
    scene.update(STATE.moved({"light": "night"}))
    np.testing.assert_array_equal(tints(scene), dark)


def test_lamp_and_receiver_are_where_the_link_has_them(scene):
    scene.update(STATE.moved({"depth": 12.0, "lamp_x": -1.0, "height": 7.0, "offset_y": 2.0}))
    lamp, receiver = points(scene, "lamp"), points(scene, "receiver")
    np.testing.assert_allclose(lamp.mean(axis=0), (-1.0, 0.0, -12.0), atol=1e-3)
    np.testing.assert_allclose(receiver.mean(axis=0), (0.0, 2.0, 7.0), atol=1e-3)
    beam = points(scene, "beam")
    rim = beam[1:] - (-1.0, 0.0, 0.0)
    np.testing.assert_allclose(np.hypot(*rim.T[:2]), 12.0 * np.tan(np.radians(10.0)), rtol=1e-5)
    np.testing.assert_allclose(rim[:, 2], 0.0, atol=1e-5)


def test_wide_cones_end_at_the_sides(scene):
    scene.update(STATE.moved({"half_angle": 70.0}))
    beam, half = points(scene, "beam"), scene.stage.half
    assert np.abs(beam[:, :2]).max() == pytest.approx(half, rel=1e-5)


def test_rays_run_from_the_lamp_to_the_aperture(scene):
    paths = next(stages.rays(STATE, lambda *_: None))
    assert len(paths.what) == stages.RAYS
    scene.show_rays(paths)
    both = np.vstack([points(scene, "unscattered"), points(scene, "scattered")])
    assert both[:, 2].min() == pytest.approx(-10.0, abs=0.05)
    assert both[:, 2].max() == pytest.approx(5.0, abs=0.05)
    scene.show_rays(None)
    assert np.ptp(points(scene, "scattered")) == 0.0


def test_the_camera_moves_only_with_the_size_of_the_stage(scene):
    before = scene.plotter.camera.position
    assert scene.update(STATE.moved({"depth": 10.5})) is False
    assert scene.plotter.camera.position == before
    assert scene.update(STATE.moved({"depth": 30.0})) is True
    assert scene.plotter.camera.position != before


def test_a_move_of_the_link_leaves_the_sea_in_its_place(scene):
    scene.update(STATE)
    sea, stage = points(scene, "sea"), scene.stage
    scene.update(STATE.moved({"depth": 11.0, "height": 5.5}))
    np.testing.assert_array_equal(points(scene, "sea"), sea)
    assert (scene.stage.center, scene.stage.half) == (stage.center, stage.half)
    assert points(scene, "lamp")[:, 2].mean() == pytest.approx(-11.0, abs=1e-3)
    assert points(scene, "water")[:, 2].min() == pytest.approx(scene.stage.bottom, rel=1e-5)
    scene.update(STATE.moved({"wind": 9.0}))
    assert np.abs(points(scene, "sea")[:, 2]).max() > 1.2 * np.abs(sea[:, 2]).max()
    scene.update(STATE.moved({"depth": 20.0}))
    assert scene.stage.half > 1.25 * stage.half
    assert np.abs(points(scene, "sea")[:, 0]).max() == pytest.approx(scene.stage.half, rel=1e-6)


def test_a_lamp_in_the_air_is_carried_by_the_aircraft():
    import meshtrace as mt
    from meshtrace.explorer.launch import scenario_of

    state = State(scenario_of(mt.Link().mirrored(), STATE.scenario.surface))
    scene = LiveScene(state.moved({"lamp_x": 1.0}))
    np.testing.assert_allclose(points(scene, "lamp").mean(axis=0), (1.0, 0.0, 5.0), atol=1e-3)
    np.testing.assert_allclose(points(scene, "receiver").mean(axis=0), (0, 0, -10.0), atol=1e-3)
    assert points(scene, "uav")[:, 2].min() > 5.0
    beam, view = points(scene, "beam")[1:], points(scene, "view")[1:]
    for rim in (beam, view):
        np.testing.assert_allclose(rim[:, 2], 0.0, atol=1e-5)
    scene.close()


def test_a_closed_scene_leaves_no_observer_to_the_garbage_collector():
    """An observer of trame that is called while its object is collected ends the process."""
    from trame_vtk.modules.vtk.serializers import (
        SynchronizationContext,
        initialize_serializers,
        reference_id,
        serialize,
    )

    def observed():
        found = [o for o in gc.get_objects() if isinstance(o, vtkObject)]
        return {o.GetAddressAsString("") for o in found if o.HasObserver("DeleteEvent")}

    initialize_serializers()
    before = observed()
    scene = LiveScene(STATE)
    window = scene.plotter.render_window
    serialize(None, window, reference_id(window), SynchronizationContext(), 1)
    assert len(observed() - before) > 10
    scene.close()
    assert observed() <= before
