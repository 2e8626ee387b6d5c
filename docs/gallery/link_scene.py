"""
A link from the water to the air
================================

A link over seas at 13 and 5 m/s: the LED and its beam of half power, bubbles below the surface,
the tilted aircraft, the field of view of its receiver on the surface, and the received light. The
marks of the ruler are level with the depths on the axis of the link.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/link_scene.png'

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

receiver = mt.Receiver(tilt_deg=14.0, tilt_azimuth_deg=-60.0)
for wind_speed, name in ((13.0, "link_scene.png"), (5.0, "link_scene_5.png")):
    link = mt.Link(receiver=receiver).in_wind(wind_speed)
    sea = JonswapSea(wind_speed=wind_speed, fetch=30e3, omega_max=9.0, seed=7)
    gain = mt.simulate(link, sea)
    print(f"{wind_speed:g} m/s: gain {gain.gain:.2e} +- {gain.gain_stderr:.1e}")
    style = viz.SceneStyle(footprint=False, off_screen=True)
    plotter = viz.scene(link, sea, received=40, gain=gain, style=style)
    viz.save_picture(plotter, name)
    plotter.close()
