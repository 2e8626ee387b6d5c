"""
A link from the water to the air
================================

A link over a sea at 13 m/s: the LED and its cone of half power, bubbles that whiten the water, the
tilted aircraft, and the field of view of its receiver on the surface.
"""

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

link = mt.Link(
    bubbles=mt.HallNovarini(wind_speed=13.0),
    receiver=mt.Receiver(tilt_deg=14.0),
)
sea = JonswapSea(wind_speed=13.0, fetch=30e3, omega_max=9.0, seed=7)
print(mt.simulate(link, sea, photons=2048))

style = viz.SceneStyle(off_screen=True, window_size=(1200, 750))
plotter = viz.scene(link, sea, style=style)
viz.save_picture(plotter, "link_scene.png")
plotter.close()
