"""Scenes show every part of a link, where it is."""

import numpy as np
import pytest
import pyvista as pv
from matplotlib.colors import to_rgb

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import FlatSea, JonswapSea, TiltedPlane
from meshtrace.viz import ScenePlotter, export, parts, scenes
from meshtrace.viz.stage import ROOM, add_caption, round_length, round_range, stage_of
from meshtrace.viz.style import BODY_COLORS, FATE_COLORS, LED_COLOR

LINK = mt.Link()
SEA = JonswapSea(wind_speed=5.0, seed=7)
SMALL = {"off_screen": True, "window_size": (480, 300)}


@pytest.fixture(scope="module")
def plain():
    """Return the default scene and its picture."""
    plotter = viz.scene(LINK, SEA, style=viz.SceneStyle(**SMALL, spacing=0.4))
    yield plotter, np.asarray(plotter.screenshot(return_img=True)).astype(int)
    plotter.close()


@pytest.fixture
def shoot():
    """Return a function that makes a scene and its picture; scenes are closed in the end."""
    made = []

    def picture(link=LINK, sea=SEA, **options):
        names = ("paths", "received", "coverage", "daylight")
        light = {k: options.pop(k) for k in names if k in options}
        style = viz.SceneStyle(**{**SMALL, "spacing": 0.4, **options})
        plotter = viz.scene(link, sea, **light, style=style)
        made.append(plotter)
        return plotter, np.asarray(plotter.screenshot(return_img=True)).astype(int)

    yield picture
    for plotter in made:
        plotter.close()


def count(image, color, tolerance=60):
    """Pixels of about a colour."""
    return int((np.abs(image - 255 * np.array(to_rgb(color))).sum(axis=2) < tolerance).sum())


def straight(n=12, height=5.0):
    """Received light that goes straight up, n paths side by side."""
    x = np.linspace(-0.4, 0.4, n)
    o = np.zeros(n)
    points = [np.stack([x * s, o, np.full(n, z)], axis=1) for s, z in ((0, -10), (1, 0), (0, 5))]
    return mt.PhotonPaths(
        np.stack(points, axis=1),
        np.full((n, 3), 1e-6),
        np.tile(np.array([0, 2, 5], np.int8), (n, 1)),
        np.arange(n),
    )


def test_the_default_scene_shows_lamp_surface_and_receiver(plain):
    plotter, image = plain
    assert image.std() > 10.0
    assert count(image, LED_COLOR, 90) > 10
    for name in ("surface", "water"):
        assert name in plotter.actors
    texts = " ".join(text for _, text, _ in plotter.texts)
    for words in ("LED, depth 10 m", "half-angle 10°", "receiver, radius 0.05 m", "wind 5 m/s"):
        assert words in texts
    assert "5 m" in texts
    assert "z [m]" in texts


def test_the_stage_fills_the_window_and_stays_in_it(shoot):
    for extent in (None, 2.0, 20.0):
        plotter, _ = shoot(extent=extent)
        low, high = np.reshape(plotter.stage.bounds, (3, 2)).T
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                            for z in (low[2], high[2])])  # fmt: skip
        matrix = plotter.camera.GetCompositeProjectionTransformMatrix(480 / 300, -1, 1)
        flat = np.array([matrix.MultiplyPoint((*c, 1.0)) for c in corners])
        seen = flat[:, :2] / flat[:, 3:]
        (left, right), (bottom, top) = ROOM
        margin = 1e-3
        assert (seen >= np.array([left, bottom]) - margin).all()
        assert (seen <= np.array([right, top]) + margin).all()
        used = (seen.max(axis=0) - seen.min(axis=0)) / (right - left, top - bottom)
        assert used.max() > 0.999


def test_received_light_is_always_among_the_paths_shown(shoot):
    plotter, image = shoot(paths=30)
    assert "photons received" in plotter.key
    assert "photons landed elsewhere" in plotter.key
    assert count(image, FATE_COLORS["received"]) > 50
    assert "footprint" in plotter.actors


def test_paths_given_are_the_paths_drawn(shoot, plain):
    default, before = plain
    plotter, image = shoot(received=straight())
    received = FATE_COLORS["received"]
    assert count(image, received) > count(before, received) + 30
    assert set(plotter.key) == {"photons received"}
    assert default.key == {}
    without, _ = shoot(received=straight(), footprint=False)
    assert "footprint" not in without.actors


def test_the_footprint_is_where_the_light_crosses(shoot):
    paths = straight(n=1)
    paths.vertex[:, 1] = (1.5, -0.5, 0.0)
    plotter, _ = shoot(received=paths)
    grid = plotter.actors["footprint"].mapper.dataset
    brightest = grid.points[np.argmax(grid["footprint"])]
    np.testing.assert_allclose(brightest[:2], (1.5, -0.5), atol=0.1)
    assert grid["footprint"].max() == 0.0
    assert grid["footprint"].min() >= -40.0


def test_dots_mark_where_light_scatters(shoot):
    paths = straight(n=1)
    paths.vertex[:, 1] = (0.0, 0.0, -4.0)
    paths.what[:] = (0, 1, 5)
    options = {"footprint": False, "labels": False}

    def dots():
        plotter, _ = shoot(received=paths, **options)
        centers = [actor.center for actor in plotter.actors.values() if hasattr(actor, "center")]
        return sum(np.allclose(center, (0.0, 0.0, -4.0), atol=1e-6) for center in centers)

    assert dots() == 1
    paths.what[:] = (0, 8, 5)
    assert dots() == 0


def test_paths_are_cut_at_the_stage(shoot):
    paths = straight(n=2)
    paths.vertex[:, 0] = (0.0, 0.0, -60.0)
    paths.vertex[:, 2] = (200.0, 0.0, 30.0)
    plotter, _ = shoot(received=paths, footprint=False, labels=False)
    bounds, stage = np.array(plotter.bounds), np.array(plotter.stage.bounds)
    slack = 0.06 * plotter.stage.size  # the thickness of lines, the aircraft above its receiver
    assert (bounds[::2] >= stage[::2] - slack).all()
    assert (bounds[1::2] <= stage[1::2] + slack).all()


def test_colour_by_weight_has_a_bar(shoot):
    plotter, _ = shoot(received=straight(), path_color="weight")
    assert "photon weight" in plotter.scalar_bars


@pytest.mark.parametrize(
    "color",
    [
        "slope",
        "slope_x",
        "plain",
        *(pytest.param(c, marks=pytest.mark.slow) for c in ("elevation", "slope_y")),
    ],
)
def test_surface_colours(shoot, color):
    plotter, _ = shoot(color=color, color_limit=0.5)
    assert len(plotter.scalar_bars) == (color != "plain")
    if color != "plain":
        low = 0.0 if color == "slope" else -0.5
        assert plotter.actors["surface"].mapper.scalar_range == (low, 0.5)


@pytest.mark.thorough
def test_parts_can_be_left_out_and_edges_shown(shoot, plain):
    _, full = plain
    for options in ({"uav": False}, {"labels": False}, {"edges": True}, {"opacity": 0.3}):
        _, other = shoot(**options)
        assert (np.abs(full - other).sum(axis=2) > 30).mean() > 5e-4, options


def drawn(plotter):
    """Return the actors of meshes."""
    return [actor for actor in plotter.actors.values() if isinstance(actor, pv.Actor)]


def bubbles_of(plotter):
    """Return the places of the bubbles drawn, (n, 3) [m]."""
    points = [a.mapper.dataset.points for a in drawn(plotter) if a.prop.render_points_as_spheres]
    return np.concatenate(points or [np.empty((0, 3))])


@pytest.mark.thorough
def test_bubbles_are_points_in_proportion_to_their_density(shoot, plain):
    layer = mt.HallNovarini(wind_speed=13.0)
    plotter, image = shoot(mt.Link(bubbles=layer))
    _, clear = shoot(mt.Link(bubbles=layer), bubbles=False)
    assert any(label.startswith("bubbles, 0.0") for label in plotter.key)
    assert ((image - clear).sum(axis=2)[:280] > 60).sum() > 500  # above the key
    below = bubbles_of(plotter)
    below[:, 2] -= export.surface_sampler(plotter.shown["surface"])(below[:, :2])
    assert below[:, 2].max() <= 1e-6
    depth = np.linspace(0.0, 20.0, 20_001)
    mean = np.trapezoid(depth * layer.b(depth), depth) / np.trapezoid(layer.b(depth), depth)
    scatter = below[:, 2].std() / np.sqrt(len(below))
    assert -below[:, 2].mean() == pytest.approx(mean, abs=4.0 * scatter)
    few, _ = shoot(mt.Link(bubbles=mt.HallNovarini(wind_speed=8.0)))
    assert 0 < len(bubbles_of(few)) < 0.5 * len(below)
    assert not len(bubbles_of(plain[0]))


def rays_of(plotter):
    """Return places and opacities of the ends of all rays drawn."""
    rays = [a.mapper.dataset for a in drawn(plotter) if "fade" in a.mapper.dataset.point_data]
    return np.concatenate([r.points for r in rays]), np.concatenate([r["tint"] for r in rays])


@pytest.mark.thorough
def test_rays_end_softly_and_are_as_bright_as_their_photons(shoot):
    """They fade at the sides of the stage and where photons land, and go with the weight."""
    wide = mt.Link(transmitter=mt.Led(half_angle_deg=40.0))
    plotter, _ = shoot(wide, paths=300, received=1, footprint=False)
    points, tint = rays_of(plotter)
    low, high = np.reshape(plotter.stage.bounds, (3, 2)).T
    beside = np.minimum(points - low, high - points)[:, :2].min(axis=1)
    assert tint[beside < 0.01 * plotter.stage.size, 3].max(initial=0) < 40
    landed = (np.abs(points[:, 2] - 5.0) < 1e-6) & (np.hypot(*points[:, :2].T) > 0.2)
    assert landed.any()
    assert tint[landed, 3].max() == 0
    paths = straight(n=1)
    paths.what[:] = (0, 2, 6)  # landed elsewhere
    paths.weight[:] = (1.0, 0.5, 0.5)
    points, tint = rays_of(shoot(received=paths, footprint=False)[0])
    near, far = (tint[np.argmin(np.abs(points[:, 2] - z)), 3] for z in (-7.5, 0.0))
    assert far == pytest.approx(0.57 * near, rel=0.1)


def test_a_long_ray_fades_and_weakens_along_its_whole_length():
    """Also one that starts far outside the stage; only its part inside is drawn."""
    stage = stage_of(LINK, FlatSea(), None)
    paths = straight(n=1)
    paths.vertex[0] = ((-150.0, 0.0, -2.0), (150.0, 0.0, -2.0), (150.0, 0.0, 5.0))
    paths.weight[0] = (1.0, 0.5, 0.5)
    rays, _ = scenes._rays(ScenePlotter(stage, off_screen=True), paths)
    assert rays.bounds[:2] == pytest.approx(stage.bounds[:2])
    weight, fade = (rays[k][np.argmin(np.abs(rays.points[:, 0]))] for k in ("weight", "fade"))
    assert weight == pytest.approx(0.75, abs=1e-3)
    assert fade == 1.0
    paths.vertex[0] = ((-6.0, 0.0, -2.0), (150.0, 0.0, -2.0), (0.0, 0.0, 0.0))
    paths.what[0] = (0, 6, -1)  # ends there: far outside, so that it does not fade before the side
    rays, _ = scenes._rays(ScenePlotter(stage, off_screen=True), paths)
    inside = np.abs(rays.points[:, 0]) < 2.0
    assert rays["fade"][inside].min() == 1.0
    np.testing.assert_allclose(
        rays["weight"], 1.0 - 0.5 * (rays.points[:, 0] + 6.0) / 156.0, atol=1e-5
    )


def test_texts_stand_beside_a_map_that_is_not_at_the_origin(shoot):
    axis = np.linspace(97.0, 103.0, 13)
    gain = np.full((13, 13), 1e-5)
    link = mt.Link(transmitter=mt.Led(position=(100.0, 0.0)),
                   receiver=mt.Receiver(position=(100.0, 0.0)))  # fmt: skip
    coverage = mt.CoverageMap(axis, axis - 100.0, gain, 0.1 * gain)
    plotter, _ = shoot(link, FlatSea(), coverage=coverage, labels=True)
    places = [place for place, text, _ in plotter.texts if text.startswith("receiver")]
    assert places[0][0] == pytest.approx(103.3)


def test_the_beam_of_a_lamp_fades_with_the_attenuation(shoot):
    """Opacity of its shells: exp(-c s)."""
    plotter, _ = shoot(mt.Link(water=mt.Water(a=0.2, b=0.1)), FlatSea())
    shells = [actor.mapper.dataset for actor in drawn(plotter)]
    shell = next(s for s in shells if "tint" in s.point_data and s.bounds[5] < 0.1 and
                 s.bounds[4] > -10.1 and s.bounds[1] < 3.0)  # fmt: skip
    way = np.linalg.norm(shell.points - (0.0, 0.0, -10.0), axis=1)
    opacity = shell["tint"][:, 3].astype(float)
    near, far = opacity[np.argmin(way)], opacity[np.abs(way - 5.0) < 0.2].mean()
    assert far / near == pytest.approx(np.exp(-0.3 * 5.0), rel=0.15)


def test_the_colours_of_the_key_differ(shoot):
    plotter, _ = shoot(mt.Link(bubbles=mt.HallNovarini(wind_speed=8.0)), paths=200)
    assert len(plotter.key) == len(set(plotter.key.values())) == 4


def test_a_footprint_too_small_to_read_has_no_colour_bar(shoot):
    near, _ = shoot(received=straight(), extent=1.0, spacing=0.05)
    assert "received light\ncrossing [dB]" in near.scalar_bars
    far, _ = shoot(received=straight(n=1))
    assert not far.scalar_bars
    assert "footprint" in far.actors


def test_a_map_is_clear_where_it_is_dark(shoot):
    axis = np.linspace(-3.0, 3.0, 13)
    gain = np.exp(-(axis[:, None] ** 2) - axis**2)
    origin = {"link": LINK.model_dump(mode="json")}
    plotter, _ = shoot(coverage=mt.CoverageMap(axis, axis, gain, 0.1 * gain, origin))
    opacity = plotter.actors["coverage"].mapper.lookup_table.values[:, 3]
    assert opacity[0] < 20
    assert opacity.max() < 200


class Layer(mt.BubblePopulation):
    @property
    def e_folding(self):
        return 0.5

    def b(self, depth):
        return 0.2 * np.exp(-np.asarray(depth) / self.e_folding)

    def phase_function(self):
        return mt.HenyeyGreenstein(g=0.8)


def test_bubbles_of_a_users_own_class_are_drawn(shoot):
    plotter, _ = shoot(mt.Link(bubbles=Layer()))
    assert "bubbles, 0.2 1/m at the surface" in plotter.key


def test_the_block_of_water_is_closed(shoot):
    plotter, _ = shoot(mt.Link(bubbles=mt.HallNovarini(wind_speed=5.0)))
    far, near = (plotter.actors[name] for name in ("water", "near water"))
    for actor in (far, near):
        assert actor.bounds[4] == pytest.approx(plotter.stage.bottom)
        assert actor.bounds[5] == pytest.approx(plotter.shown["surface"].bounds[1, 2], abs=0.05)
    assert far.prop.culling == "front"
    assert near.prop.culling == "back"
    colors = near.mapper.lookup_table
    low, high = (sum(colors.map_value(z)[:3]) for z in (plotter.stage.bottom, 0.0))
    assert high > 3.0 * low  # dark below
    assert near.prop.opacity < far.prop.opacity
    sides = parts.walls(plotter.shown["surface"], plotter.stage.bottom)
    outwards = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    assert ((sides.mean(axis=1) * outwards)[:, :2].sum(axis=1) > 0.0).all()


@pytest.fixture(scope="module")
def crest():
    """Return a wave whose crest hangs over, the same for all y."""
    turn = np.linspace(-np.pi, np.pi, 81)
    x = np.concatenate([[-8.0], 2.0 * turn / np.pi + 1.6 * np.sin(turn), [8.0]])
    z = np.concatenate([[0.0], 0.8 * (1.0 + np.cos(turn)), [0.0]])
    y = np.linspace(-8.0, 8.0, 33)
    grid = np.stack(np.broadcast_arrays(x[:, None], y, z[:, None]), axis=-1)
    n = np.arange(grid[..., 0].size).reshape(grid.shape[:2])
    a, b, c, d = n[:-1, :-1], n[1:, :-1], n[1:, 1:], n[:-1, 1:]
    faces = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    mesh = mt.TriangleMesh(grid.reshape(-1, 3), faces, overhangs=True)
    assert mesh.facing_down
    return mesh


def test_a_view_ends_at_the_first_sheet_of_a_crest(crest):
    """Its rim once jumped between the sheets of one place (x, y)."""
    eye = np.array([0.5, 0.0, 6.0])
    rim = parts.cone_rim(crest, tuple(eye), (0.0, 0.0, -1.0), 25.0, 50.0)
    first = crest.to_trimesh().ray.intersects_location(
        np.tile(eye, (96, 1)), (rim - eye)[:-1], multiple_hits=False
    )
    order = np.argsort(first[1])
    np.testing.assert_allclose(rim[:-1], first[0][order], atol=1e-5)
    # far from the folds neighbours are neighbours
    step = np.linalg.norm(np.diff(rim, axis=0), axis=1)
    assert (step > 8.0 * np.median(step)).sum() <= 4


def test_the_cut_through_a_crest_has_the_area_of_its_water(crest):
    """Walls from every point of the edge down once covered the air below the crest."""
    cut = parts.cut_to(crest, (-5.0, 5.0, -4.0, 4.0, -9.0, 9.0))
    assert np.ptp(cut.vertices, axis=0)[:2] == pytest.approx([10.0, 8.0])
    sides = parts.walls(cut, -2.0)
    normals = 0.5 * np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    front = np.abs(sides[:, :, 1] + 4.0).max(axis=1) < 1e-6
    line = crest.vertices[np.isclose(crest.vertices[:, 1], 0.0)]
    x, z = line[:, 0].clip(-5.0, 5.0), line[:, 2]  # level water there
    water = 0.5 * ((z[1:] + z[:-1] + 4.0) * np.diff(x)).sum()
    assert -normals[front, 1].sum() == pytest.approx(water, rel=1e-6)
    assert np.abs(normals[front]).sum() == pytest.approx(water, rel=1e-6)  # nowhere twice


def test_slopes_of_a_crest_leave_colours_to_the_others(shoot, crest):
    plotter, _ = shoot(None, crest, color="slope_x")
    low, high = plotter.actors["surface"].mapper.scalar_range
    assert -2.0 <= low < -1.0
    assert 1.0 < high <= 2.0


def test_the_aircraft_leans_with_its_receiver(shoot, plain):
    _, level = plain
    _, leaning = shoot(mt.Link(receiver=mt.Receiver(tilt_deg=20.0, tilt_azimuth_deg=90.0)))
    top = slice(0, 80)
    assert (np.abs(level - leaning).sum(axis=2) > 60)[top].sum() > 40


@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -1), (0.6, 0, 0.8), (0.48, -0.64, -0.6)])
def test_rotation_turns_z_to_the_axis(axis):
    turn = parts.rotation_from_z(axis)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(turn @ (0, 0, 1), axis, atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_cones_end_where_the_surface_is():
    flat = FlatSea().mesh(extent=10.0, spacing=1.0)
    rim = parts.cone_rim(flat, (1.0, 2.0, -10.0), (0.0, 0.0, 1.0), 10.0, 100.0)
    radius = np.hypot(rim[:, 0] - 1.0, rim[:, 1] - 2.0)
    np.testing.assert_allclose(radius, 10.0 * np.tan(np.radians(10.0)), rtol=1e-6)
    np.testing.assert_allclose(rim[:, 2], 0.0, atol=1e-6)

    plane = TiltedPlane(slope_x=0.1)
    rim = parts.cone_rim(
        plane.mesh(extent=20.0, spacing=1.0), (0.0, 0.0, 5.0), (0.0, 0.0, -1.0), 30.0, 100.0
    )
    np.testing.assert_allclose(rim[:, 2], plane.elevation(*rim[:, :2].T), atol=1e-3)
    ray = rim - (0.0, 0.0, 5.0)
    cosine = -ray[:, 2] / np.linalg.norm(ray, axis=1)
    np.testing.assert_allclose(cosine, np.cos(np.radians(30.0)), atol=1e-9)


def test_a_small_extent_is_a_close_up(shoot):
    plotter, _ = shoot(extent=1.5, spacing=0.1)
    assert plotter.stage.half == 1.5
    assert plotter.stage.bottom == -1.5
    assert not any("LED" in text for _, text, _ in plotter.texts)


def test_coverage_is_seen_from_above(shoot):
    axis = np.linspace(-3.0, 3.0, 13)
    gain = np.exp(-(axis[:, None] ** 2) - axis**2)
    origin = {"link": LINK.model_dump(mode="json")}
    coverage = mt.CoverageMap(axis, axis, gain, 0.1 * gain, origin)
    plotter, _ = shoot(coverage=coverage)
    assert plotter.actors["coverage"].bounds[4:] == (5.0, 5.0)
    assert "channel gain" in plotter.scalar_bars
    (place,) = (point for point, text, _ in plotter.texts if text.startswith("receiver"))
    assert place[0] > axis[-1]  # beside the map


@pytest.mark.parametrize(
    "link",
    [
        mt.Link(transmitter=mt.Sun(zenith_deg=30.0), receiver=mt.WaterAperture(depth=5.0)),
        mt.Link(transmitter=(mt.Led(), mt.GaussianBeam(position=(2.0, 0.0), depth=6.0))),
        mt.Link(transmitter=mt.IsotropicSource(), receiver=mt.Receiver(fov_deg=180.0)),
        mt.Link(receiver=(mt.Receiver(), mt.Receiver(height=8.0, position=(3.0, 0.0)))),
    ],
    ids=["sun", "two-sources", "isotropic", "two-receivers"],
)
def test_every_kind_of_link_is_shown(shoot, link):
    plotter, image = shoot(link)
    for item in (*link.transmitters, *link.receivers):
        depth = getattr(item, "depth", None)
        if depth is not None:
            assert plotter.stage.bottom < -depth
    assert image.std() > 10.0


def test_a_downlink_has_its_lamp_above_and_its_receiver_below(shoot):
    link = mt.Link().mirrored().replace("transmitter.tilt_deg", 5.0)
    plotter, image = shoot(link, received=10)
    assert plotter.stage.bottom < -10.0 < 5.0 < plotter.stage.top
    assert count(image, LED_COLOR, 90) > 10
    assert "photons received" in plotter.key


def test_links_that_only_analog_photons_follow(shoot):
    link = mt.Link(transmitter=mt.TopHatBeam(radius=0.2, divergence_deg=5.0))
    plotter, _ = shoot(link, paths=20)
    assert "photons landed elsewhere" in plotter.key
    with pytest.raises(ValueError, match=r"transmitter: .*allowed: a point source"):
        shoot(link, received=10)


def test_a_mesh_alone(shoot):
    plotter, image = shoot(None, SEA.mesh(extent=5.0, spacing=0.5), spacing=None)
    assert plotter.stage.half == pytest.approx(5.0)
    assert image.std() > 5.0


@pytest.mark.thorough
def test_scenes_chain(shoot):
    plotter, _ = shoot(labels=False)
    assert viz.look(viz.add_scale(viz.add_compass(plotter, 5.0))) is plotter
    before = np.asarray(plotter.screenshot(return_img=True)).astype(int)
    again = viz.scene(LINK, SEA, time=1.0, plotter=plotter, style=viz.SceneStyle(spacing=0.4))
    assert again is plotter
    after = np.asarray(plotter.screenshot(return_img=True)).astype(int)
    assert (np.abs(before - after).sum(axis=2) > 30).mean() > 1e-3


def test_unknown_choices_are_refused(shoot):
    with pytest.raises(ValueError, match=r"color: 'depth', allowed: water, elevation"):
        shoot(color="depth")
    with pytest.raises(ValueError, match=r"color: 'photon', allowed: fate or weight"):
        shoot(received=straight(), path_color="photon")


@pytest.mark.parametrize(("length", "round_one"), [(3.75, 2.0), (5.0, 5.0), (0.99, 0.5), (10, 10)])
def test_scale_bars_have_round_lengths(length, round_one):
    assert round_length(length) == pytest.approx(round_one)


@pytest.mark.parametrize(
    ("values", "limits"),
    [((-0.63, 0.56), (-0.7, 0.7)), ((-0.55, -0.28), (-0.6, -0.2)), ((0.0, 0.0), (0.0, 2e-7))],
)
def test_colour_bars_end_at_round_numbers(values, limits):
    assert round_range(*values) == pytest.approx(limits)


def test_seas_too_fine_to_draw_are_refused(shoot):
    with pytest.raises(ValueError, match=r"spacing: 0.001, allowed: >= 0\.00"):
        shoot(spacing=1e-3)


def test_a_map_of_so_many_photons(shoot):
    plotter, _ = shoot(coverage=4096)
    assert plotter.shown["map"].gain.shape == (40, 40)
    assert plotter.shown["map"].x.max() < 0.5 * plotter.stage.half
    with pytest.raises(ValueError, match="coverage: of a mesh alone"):
        shoot(None, SEA.mesh(extent=2.0, spacing=0.5), coverage=10)


def test_without_labels_no_text_is_written(shoot, plain):
    assert plain[0].texts
    assert not shoot(labels=False)[0].texts


def test_choppy_seas_end_at_the_sides_of_the_stage(shoot):
    sea = JonswapSea(wind_speed=8.0, choppy=True, seed=2)
    plotter, _ = shoot(mt.Link(), sea, spacing=0.5)
    half = plotter.stage.half
    assert plotter.shown["surface"].bounds[1, :2].max() > half + 0.1  # the mesh is larger
    drawn = plotter.actors["surface"].bounds
    np.testing.assert_allclose(drawn[:4], [-half, half, -half, half], atol=1e-6)


def test_bodies_are_seen_where_they_are_and_exported(shoot, plain, tmp_path):
    """A wall changes pixels where it is on the stage; files for ParaView have all of it."""
    corners = [(-40.0, 3.0, -9.0), (4.0, 3.0, -9.0), (4.0, 3.0, -4.0), (-40.0, 3.0, -4.0)]
    wall = mt.TriangleMesh(corners, [(0, 1, 2), (0, 2, 3)], overhangs=True)
    _, before = plain
    for reflection, name in (("lambert", "body"), ("mirror", "mirror body")):
        body = mt.Body(wall, reflection=reflection)
        far = mt.Body(wall, position=(0.0, 500.0, 0.0))
        plotter, image = shoot(LINK.replace(objects=(body, far)))
        assert plotter.key == {name: BODY_COLORS[reflection]}
        assert "body_2" not in plotter.actors
        x, _, z = np.reshape(plotter.actors["body_1"].bounds, (3, 2))
        np.testing.assert_allclose(x, (-plotter.stage.half, 4.0), atol=1e-6)
        np.testing.assert_allclose(z, (-9.0, -4.0))
        changed = (np.abs(image - before).sum(axis=2) > 20).mean()
        assert 0.02 < changed < 0.3
    export.export_scene(plotter, tmp_path)
    np.testing.assert_allclose(pv.read(tmp_path / "body_1.vtp").points, wall.vertices)
    assert pv.read(tmp_path / "body_2.vtp").bounds[2] == pytest.approx(503.0)


def test_the_background_is_that_of_the_light(shoot):
    """By day only the waves were once lit."""
    night, day, moon = (
        shoot(daylight=light and mt.Daylight.model_validate(light))[1][5, 5].sum()
        for light in (
            None,
            {"direct": 1.2, "diffuse": 0.3, "sun_zenith_deg": 40.0},
            {"direct": 1e-7, "diffuse": 1e-7, "sun_zenith_deg": 40.0},
        )
    )
    assert day > 1.8 * night
    assert moon == night


def test_a_narrow_bundle_does_not_hide_what_is_below(shoot):
    """Rays side by side in a beam of a few pixels once added up to an opaque band."""
    strengths = []
    for width in (1.0, 0.01):
        paths = straight(n=40)
        paths.vertex[..., 0] *= width
        plotter, _ = shoot(received=paths, footprint=False)
        mappers = [getattr(actor, "mapper", None) for actor in plotter.actors.values()]
        rays = [getattr(mapper, "dataset", None) for mapper in mappers]
        tints = [d["tint"] for d in rays if d is not None and "tint" in d.array_names]
        gold = [t[:, 3].max() for t in tints if (t[:, :3] == (255, 176, 46)).all()]
        strengths.append(max(gold))
    assert strengths[1] < 0.7 * strengths[0]


def test_a_caption_breaks_between_clauses(shoot):
    plotter, _ = shoot()
    before = len(plotter.actors)
    clause = "a clause of some length and of one colour"
    add_caption(plotter, "; ".join(6 * [clause]))
    lines = [a.input for a in list(plotter.actors.values())[before:]]
    assert len(lines) > 1
    assert all(
        line.replace("\N{NO-BREAK SPACE}", " ").strip("; ").endswith(clause) for line in lines
    )
