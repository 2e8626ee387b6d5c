"""
A moving sea with its gain
==========================

A movie of the sea at 5 m/s, with received rays and the gain over time:

.. raw:: html

   <video controls loop muted width="100%" src="../movie.mp4"></video>
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/surface_5_elevation.png'

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

FRAMES = 11

link, sea = mt.Link(), JonswapSea(wind_speed=5.0, omega_max=9.0, seed=7)
times = 0.4 * np.arange(FRAMES)
viz.save_movie(link, sea, times, "movie.mp4", frame_rate=5.0, received=30)
