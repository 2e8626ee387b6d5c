"""
Light that stays on its side
============================

A link of two vehicles under water whose straight way is blocked: the waves are its mirror. And a
lidar: light that comes back from the surface, the water and the bottom, over eight seas.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/under_water.png'

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

viz.use_style()
sea = JonswapSea(wind_speed=5.0, seed=1)
end = mt.WaterReceiver(depth=3.0, position=(12.0, 0.0), radius=0.1, fov_deg=180.0)
link = mt.Link(transmitter=mt.Led(depth=5.0, half_angle_deg=60.0), receiver=end)
style = viz.SceneStyle(off_screen=True)
plotter = viz.scene(link, sea, received=60, gain=mt.simulate(link, sea), style=style)
viz.save_picture(plotter, "under_water.png")
plotter.close()

# %%
# The waveform of a laser pulse from 300 m, as shares of the emitted energy.

lidar = mt.Link(
    transmitter=mt.AirTopHatBeam(height=300.0, divergence_deg=0.0286),
    receiver=mt.Receiver(height=300.0, fov_deg=0.286, radius=0.1),
    water=mt.Water(a=0.114, b=0.037, bottom_depth=10.0, bottom_albedo=0.15),
)
result = mt.lidar(lidar, sea, seas=8, photons=4096)
print(result)
viz.save_picture(viz.plot(result).figure, "lidar.png")
