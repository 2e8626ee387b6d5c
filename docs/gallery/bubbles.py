"""
Bubbles under a windy sea
=========================

Breaking waves fill the uppermost metres with bubbles, which scatter light: the coefficients at
three winds, and the layer in a scene.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/bubbles.png'

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

viz.use_style()
layers = {f"{u:g} m/s": mt.HallNovarini(wind_speed=u) for u in (5.0, 9.0, 13.0)}
depth = np.linspace(0.0, 10.0, 201)
dims = ("wind", "depth")
data = xr.Dataset(
    {
        "b_bub": (dims, [layer.b(depth) for layer in layers.values()]),
        "n_bubbles": (dims, [layer.number_density(depth) for layer in layers.values()]),
    },
    {"wind": list(layers), "depth": depth},
)
for quantity in ("b_bub", "n_bubbles"):
    ax = viz.plot_bubble_profile(data, quantity=quantity)
    viz.save_picture(ax.figure, f"bubbles_{quantity}.png")
for name, layer in layers.items():
    print(f"{name}: b = {layer.b(0.0):.2g} 1/m at the surface, {layer.b(4.0):.2g} 1/m at 4 m")

# %%
# The layer at 13 m/s in a scene of 6 m. Points are bubbles, one of many and enlarged, in proportion
# to what they scatter: light that comes from below loses its direction in the last metre.

link = mt.Link(bubbles=layers["13 m/s"], transmitter=mt.Led(depth=4.0))
sea = JonswapSea(wind_speed=13.0, fetch=30e3, omega_max=9.0, seed=7)
style = viz.SceneStyle(extent=3.0, off_screen=True)
plotter = viz.scene(link, sea, paths=600, style=style)
viz.save_picture(plotter, "bubbles.png")
plotter.close()
