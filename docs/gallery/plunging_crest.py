"""
Light in a plunging crest
=========================

A fan of beams under a plunging crest, a mesh that overhangs, traced by the analog estimator: light
that meets the surface beyond the critical angle of 48.75 degrees stays in the jet (gold), the rest
is refracted into the air (blue).

.. image:: /gallery/pictures/plunging_crest.png
   :alt: Light guided by the jet of a plunging crest and refracted into its tube

The crest is a free outline around a tube, an ellipse as in A. L. New, "A class of elliptical
free-surface flows", Journal of Fluid Mechanics 130 (1983), with axes of 1 : sqrt 3; it is not the
result of a flow computation.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/plunging_crest.png'

import numpy as np
import pyvista as pv
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea, from_trimesh
from meshtrace.viz.style import FONT_FILE

LEFT, RIGHT, BOTTOM, TOP = -7.0, 7.0, -3.2, 4.6  # part of the plane y = 0 that is drawn [m]
LAMP = (-2.9, -1.25)  # x, z [m]
ZENITHS_DEG = np.linspace(34.0, 72.0, 58)
PHOTONS = 200  # of a beam
NIGHT, DUSK, WATER, BACK, SKIN = "#040913", "#2c5673", "#0a3d5c", "#1b7a9c", "#d8f8ff"
REFRACTED, GUIDED = "#4fc3ff", "#ffae22"
LIGHTS = (
    ((0.4, 3.0, 0.9), "#ffdfae", 1.5),
    ((-1.0, 0.4, 0.8), "#8fc8ff", 0.9),
    ((1.0, -1.2, -0.2), "#ffc46b", 0.35),
)
"""Directions, colours and strengths of dusk, sky and the glow of the section."""


def profile(points: int = 900) -> np.ndarray:
    """Return the cut of the crest, (n, 2) of x and z [m], with the air on the left of its way."""
    long, lean = 0.86, np.radians(35.0)
    angle = np.radians(np.linspace(-48.0, 238.0, 36))
    tube = np.array([long * np.cos(angle), long / np.sqrt(3.0) * np.sin(angle)]).T
    turn = np.array([[np.cos(lean), -np.sin(lean)], [np.sin(lean), np.cos(lean)]])
    tube = np.array([0.55, 0.62]) + tube @ turn.T
    back = [
        (-40, 0.0),
        (-25, 0.0),
        (-17, 0.0),
        (-14, 0.0),
        (-11, 0.01),
        (-9, 0.04),
        (-7, 0.12),
        (-5.5, 0.25),
        (-4.2, 0.45),
    ]
    back += [(-3, 0.74), (-2, 1.06), (-1.2, 1.33), (-0.5, 1.52), (0.1, 1.61), (0.65, 1.6)]
    lip = [(1.1, 1.45), (1.38, 1.18), (1.48, 0.88), (1.44, 0.6), (1.36, 0.5)]
    trough = [(0.75, -0.04), (1.5, -0.12), (2.4, -0.16), (3.4, -0.15), (4.8, -0.1)]
    trough += [(6.5, -0.04), (9, -0.01), (14, 0.0), (20, 0.0), (30, 0.0), (40, 0.0)]
    knots = np.concatenate([back, lip, tube, trough])
    steps = np.sqrt(np.hypot(*np.diff(knots, axis=0).T))
    curve = CubicSpline(np.concatenate([[0.0], np.cumsum(steps)]), knots)
    return curve(np.linspace(0.0, steps.sum(), points))


def crest(rows: int = 181, half: float = 22.0) -> mt.TriangleMesh:
    """Return the crest as a mesh that bends back and dies out to both sides of y = 0.

    Ripples grow away from that plane. Lifting by a function of x and y keeps sheets apart.
    """
    cut = profile()
    y = np.linspace(-half, half, rows)
    x, z = (np.repeat(column[:, None], rows, axis=1) for column in cut.T)
    fall = np.exp(-((y / 9.0) ** 2))
    x, y = x - 0.012 * y**2, np.broadcast_to(y, x.shape)
    ripples = JonswapSea(wind_speed=5.0, fetch=5e3, omega_max=7.0, seed=4).elevation(x, y)
    vertices = np.stack([x, y, z * fall + 0.7 * ripples * (1.0 - np.exp(-((y / 3.0) ** 2)))])
    corner = np.arange(x.size).reshape(x.shape)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    return from_trimesh((vertices.reshape(3, -1).T, faces), overhangs=True, normals="angle")


def link() -> mt.Link:
    """Return a fan of parallel beams in clear water, in the plane y = 0."""
    x, z = LAMP
    fan = tuple(
        mt.TopHatBeam(depth=-z, position=(x, 0.0), divergence_deg=0.0, zenith_deg=float(zenith))
        for zenith in ZENITHS_DEG
    )
    clear = mt.Water(a=0.0, b=0.0, bottom_depth=6.0)
    return mt.Link(transmitter=fan, receiver=mt.Receiver(height=8.0), water=clear)


def light(paths: mt.PhotonPaths, width: int) -> np.ndarray:
    """Return images of the light before and after its first total reflection.

    A beam of full weight has brightness 1. Every path ends at the surface; light reflected there
    continues as the next path of the same photon.
    """
    shape = round(width * (TOP - BOTTOM) / (RIGHT - LEFT)), width
    image, before, arrived, total = np.zeros((2, *shape)), -1, 1.0, False
    for vertex, weight, n, photon in zip(
        paths.vertex, paths.weight, paths.length, paths.photon, strict=True
    ):
        total = photon == before and (total or weight[0] > 0.999 * arrived)
        before, arrived = photon, weight[max(n - 2, 0)]
        for p, q, w in zip(vertex[: n - 1], vertex[1:n], weight[: n - 1], strict=True):
            way = np.hypot(*(q - p)[[0, 2]])
            shown = min(way, 14.0)
            at = (np.arange(int(shown * 1.3 * width / (RIGHT - LEFT)) + 1) + 0.5)[:, None]
            points = p + at / len(at) * (shown / max(way, 1e-9)) * (q - p)
            column = ((points[:, 0] - LEFT) / (RIGHT - LEFT) * width).astype(int)
            row = ((TOP - points[:, 2]) / (TOP - BOTTOM) * shape[0]).astype(int)
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < shape[0])
            np.add.at(image[int(total)], (row[inside], column[inside]), w)
    return image / (1.3 * PHOTONS)


def glow(image: np.ndarray) -> np.ndarray:
    """Return brightness 0..1 of an image of light: sharp rays in a soft halo."""
    ray, halo = gaussian_filter(image, 1.0), gaussian_filter(image, 7.0)
    return 1.0 - np.exp(-(np.maximum(2.6 * ray + 1.5 * halo - 0.03, 0.0) ** 0.85))


def rgb(color: str) -> np.ndarray:
    """Return a colour as numbers 0..1."""
    return np.array(pv.Color(color).float_rgb)


def section(paths: mt.PhotonPaths, width: int = 2400) -> np.ndarray:
    """Return the plane y = 0 as an RGBA image: water, and light in water and air."""
    from matplotlib.path import Path as Outline

    refracted, guided = (glow(image) for image in light(paths, width))
    cut = profile()
    outline = Outline(np.concatenate([cut, [(40.0, -9.0), (-40.0, -9.0)]]))
    rows, columns = refracted.shape
    x = LEFT + (np.arange(columns) + 0.5) / columns * (RIGHT - LEFT)
    z = TOP - (np.arange(rows) + 0.5) / rows * (TOP - BOTTOM)
    places = np.array(np.meshgrid(x, z)).reshape(2, -1).T
    wet = outline.contains_points(places).reshape(rows, columns)
    depth = np.clip((1.6 - z) / 3.4, 0.0, 1.0)[:, None, None]
    color = (1.0 - depth) * rgb(WATER) + depth * rgb(NIGHT)
    color = np.broadcast_to(color, (*wet.shape, 3)).copy()
    color[~wet] = 0.0
    for level, shade in ((refracted, rgb(REFRACTED)), (guided, rgb(GUIDED))):
        hot = shade + 0.75 * (1.0 - shade) * np.clip(3.0 * level - 2.0, 0.0, 1.0)[..., None]
        color = 1.0 - (1.0 - color) * (1.0 - level[..., None] * hot)
    light_alpha = 1.0 - (1.0 - refracted) * (1.0 - guided)
    alpha = np.where(wet, 0.93 + 0.07 * light_alpha, light_alpha)
    color[~wet] /= np.maximum(alpha[~wet], 1e-3)[:, None]
    return (255 * np.clip(np.dstack([color, alpha]), 0.0, 1.0)).astype(np.uint8)


def picture(mesh: mt.TriangleMesh, paths: mt.PhotonPaths) -> pv.Plotter:
    """Return the far half of the crest behind its lit section."""
    with pv.vtk_verbosity("off"):
        plotter = pv.Plotter(off_screen=True, window_size=(1600, 1000), lighting="none")
    plotter.set_background(NIGHT, top=DUSK)
    plotter.enable_anti_aliasing("ssaa")
    far = mesh.faces[(mesh.vertices[mesh.faces][..., 1] > -1e-9).all(axis=1)]
    sea = pv.PolyData.from_regular_faces(mesh.vertices, far)
    sea.point_data.active_normals = mesh.vertex_normals
    plotter.add_mesh(
        sea, color=BACK, smooth_shading=True, ambient=0.08, diffuse=0.7, specular=1.0,
        specular_power=30.0,
    )  # fmt: skip
    plane = pv.Plane(
        center=(0.5 * (LEFT + RIGHT), 0.0, 0.5 * (BOTTOM + TOP)), direction=(0.0, -1.0, 0.0),
        i_size=TOP - BOTTOM, j_size=RIGHT - LEFT, i_resolution=1, j_resolution=1,
    )  # fmt: skip
    x, _, z = plane.points.T
    plane.active_texture_coordinates = np.array(
        [(x - LEFT) / (RIGHT - LEFT), (z - BOTTOM) / (TOP - BOTTOM)]
    ).T
    texture = pv.numpy_to_texture(section(paths))
    texture.interpolate = True
    plotter.add_mesh(plane, texture=texture, lighting=False)
    skin = pv.MultipleLines(np.insert(profile(), 1, -0.004, axis=1))
    skin = skin.clip_box((LEFT, RIGHT, -1.0, 1.0, BOTTOM, TOP), invert=False)
    plotter.add_mesh(skin.extract_surface(algorithm=None), color=SKIN, line_width=2.0, opacity=0.8)
    for place, shade, strength in LIGHTS:
        lamp = pv.Light(position=place, color=shade, intensity=strength, light_type="scene light")
        lamp.positional = False
        plotter.add_light(lamp)
    plotter.camera.position = (8.0, -12.6, 3.7)
    plotter.camera.focal_point = (0.35, 0.0, 0.55)
    plotter.camera.up = (0.0, 0.0, 1.0)
    plotter.camera.view_angle = 21.0
    plotter.reset_camera_clipping_range()
    words = {"light from the lamp": REFRACTED, "light after its first total reflection": GUIDED}
    for left, (text, color) in zip((0.02, 0.18), words.items(), strict=True):
        look = {"font_size": 12, "font_file": FONT_FILE, "color": color, "viewport": True}
        plotter.add_text(text, position=(left, 0.03), **look)
    return plotter


mesh = crest()
print(f"{len(mesh.faces)} facets, {mesh.facing_down} of them face down")
result = mt.simulate(link(), mesh, photons=20_000)
for fate in ("landed", "bottom", "left_domain", "event_limit"):
    print(f"{fate}: {result.fates[fate].weight:.4f} of the light")
paths = mt.trace_paths(link(), mesh, PHOTONS * len(ZENITHS_DEG))
plotter = picture(mesh, paths)
viz.save_picture(plotter, "plunging_crest.png")
plotter.close()
