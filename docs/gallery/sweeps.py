"""
Gain over depth, and convergence with the mesh
==============================================

The gain of LEDs with two half angles over the depth.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/sweep_depth.png'

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea, SinusoidalSea

viz.use_style()
sea = JonswapSea(wind_speed=5.0, seed=7)
depths, half_angles = np.arange(5.0, 41.0, 5.0), (5.0, 20.0)
runs = [
    [mt.simulate(mt.Link(transmitter=mt.Led(depth=d, half_angle_deg=a)), sea) for d in depths]
    for a in half_angles
]
dims = ("half_angle", "depth")
data = xr.Dataset(
    {
        "gain": (dims, [[r.gain for r in row] for row in runs]),
        "gain_stderr": (dims, [[r.gain_stderr for r in row] for row in runs]),
    },
    {"half_angle": [f"half-angle {a:g}°" for a in half_angles], "depth": depths},
)
ax = viz.plot_sweep(data)
viz.save_picture(ax.figure, "sweep_depth.png")

# %%
# Convergence of the gain with the spacing of the mesh, over one wave.

wave = SinusoidalSea(amplitude=0.12, wavelength=6.0)
study = mt.convergence_study(mt.Link(), wave, (0.8, 0.6, 0.4, 0.3), ("vertex",), photons=512)
print(study)
ax = viz.plot_convergence(study)
viz.save_picture(ax.figure, "convergence.png")
