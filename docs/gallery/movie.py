"""
A moving sea with its gain
==========================

Four seconds of a sea at 5 m/s at natural speed, with received light and the gain so far:

.. raw:: html

   <video controls loop muted width="100%" src="../movie.mp4"></video>
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/surface_5_water.png'

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

FRAMES = 80

link, sea = mt.Link(), JonswapSea(wind_speed=5.0, omega_max=9.0, seed=7)
times = np.arange(FRAMES) / 20.0  # natural speed
viz.save_movie(link, sea, times, "movie.mp4", received=30, quality=5.5)
