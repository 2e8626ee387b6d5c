"""
Photon paths and their fates
============================

Light of an LED as 1500 photons that fade with the weight that they have left, coloured by their
fate. Received ones are drawn in proportion to the light they carry; dots mark their scattering.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/photon_paths.png'

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

link = mt.Link(
    water=mt.Water(a=0.114, b=0.12),
    bubbles=mt.HallNovarini(wind_speed=8.0),
    transmitter=mt.Led(depth=8.0, half_angle_deg=12.0),
)
sea = JonswapSea(wind_speed=8.0, omega_max=8.0, seed=3)

style = viz.SceneStyle(off_screen=True)
gain = mt.simulate(link, sea)
plotter = viz.scene(link, sea, paths=1500, received=30, gain=gain, style=style)
viz.save_picture(plotter, "photon_paths.png")
plotter.close()

# %%
# The same close to the surface, with the edges of its facets: light is refracted at its crossings.

wide = link.model_copy(update={"transmitter": mt.Led(depth=8.0, half_angle_deg=30.0)})
plotter = viz.scene(
    wide,
    sea,
    paths=2500,
    received=20,
    style=style.replace(edges=True, extent=2.0, spacing=0.2, opacity=0.5),
)
viz.save_picture(plotter, "photon_paths_surface.png")
plotter.close()
