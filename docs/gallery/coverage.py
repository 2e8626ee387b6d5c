"""
Gain over the plane of the receiver
===================================

The mean gain over a moving sea at 5 m/s for every place of a receiver at a height of 5 m, as a map
and in the scene.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/coverage_scene.png'

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

viz.use_style()
link, sea = mt.Link(), JonswapSea(wind_speed=5.0, seed=7)
coverage = mt.coverage_map(
    link, sea, extent=5.0, step=0.25, times=np.arange(0.0, 10.0, 2.0), photons=200_000
)
print(coverage)
ax = viz.plot_coverage(coverage, decibel=True)
viz.save_picture(ax.figure, "coverage.png")

# %%
# The same map above the sea.

style = viz.SceneStyle(uav=False, off_screen=True)
plotter = viz.scene(link, sea, coverage=coverage, style=style)
viz.save_picture(plotter, "coverage_scene.png")
plotter.close()
