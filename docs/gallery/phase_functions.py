"""
Phase functions of sea water and bubbles
========================================

Densities of the scattering angle, their distribution functions, and the share scattered backwards.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/phase_functions.png'

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import viz

viz.use_style()
phases = {
    "Fournier-Forand": mt.FournierForand(n=1.1, mu=3.5835),
    "Petzold": mt.Petzold(),
    "Henyey-Greenstein, g = 0.924": mt.HenyeyGreenstein(g=0.924),
    "bubbles (Mie)": mt.HallNovarini(wind_speed=13.0).phase_function(),
}
theta, dims = np.radians(np.geomspace(0.1, 180.0, 400)), ("medium", "theta")
data = xr.Dataset(
    {
        "phase_function": (dims, [phase.pdf(theta) for phase in phases.values()]),
        "phase_cdf": (dims, [phase.cdf(theta) for phase in phases.values()]),
    },
    {"medium": list(phases), "theta": theta},
)
ax = viz.plot_phase_function(data)
viz.save_picture(ax.figure, "phase_functions.png")
ax = viz.plot_phase_cdf(data)
viz.save_picture(ax.figure, "phase_cdf.png")
for name, phase in phases.items():
    backward = phase.backscatter_fraction
    print(f"{name:29} mean cosine {phase.mean_cosine:.4f}, backward {backward:.4f}")
