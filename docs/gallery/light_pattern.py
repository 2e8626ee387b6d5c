"""
Caustics above the sea
======================

Unscattered light of the default link on the plane 5 m above a resolved sea at 5 m/s: the caustics
of all waves longer than 11 cm, and the same with the slopes of the shorter ones, which every
receiver sees. The brightest cell has 40 and 5 times the mean.

.. image:: /gallery/pictures/light_pattern.png
   :alt: Caustics above the sea, sharp and blurred
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/light_pattern.png'

import numpy as np
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import resolved_sea

EXTENT = 1.5  # m
FRAMES = 20

viz.use_style()
sharp = mt.Link(physics={"unresolved": "none"})  # light is bent by the waves of the band alone
sea = resolved_sea(5.0, fetch=30e3, seed=3).model_copy(update={"omega_max": 24.0})
maps = [mt.light_pattern(link, sea, EXTENT, 0.01) for link in (sharp, mt.Link())]

figure = Figure(figsize=(9.6, 4.9), dpi=110, layout="constrained")
titles = ("all waves longer than 11 cm", "with the slopes of shorter waves")
scale = PowerNorm(0.5, 0.0, 16.0)  # as the eye, which sees roots
axes = figure.subplots(1, 2, sharey=True)
for ax, pattern, title in zip(axes, maps, titles, strict=True):
    relative = pattern.gain / pattern.gain.mean()
    print(f"{title}: brightest cell {relative.max():.1f} times the mean")
    image = viz.marks.heat_map(ax, pattern.x, pattern.y, relative, "", colors="inferno", norm=scale)
    ax.set_title(title)
axes[1].set_ylabel("")
label = "gain of unscattered light over its mean"
ticks = [0, 1, 2, 4, 8, 16]
figure.colorbar(image, ax=axes, extend="max", label=label, ticks=ticks, shrink=0.8, aspect=18)
viz.save_picture(figure, "light_pattern.png")

# %%
# The caustics move within a tenth of a second. Here they are five times slower than the sea:
#
# .. raw:: html
#
#    <video controls loop muted width="100%" src="../light_pattern.mp4"></video>

times = 0.02 * np.arange(FRAMES)
viz.save_light(sharp, sea, "light_pattern.mp4", times, extent=EXTENT, frame_rate=10.0)
