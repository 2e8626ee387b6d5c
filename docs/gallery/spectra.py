"""
Wave spectra and spreadings
===========================

Spectra at a wind of 13 m/s, and the distribution of the waves over the directions.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/spectra.png'

import numpy as np
import xarray as xr

from meshtrace import viz
from meshtrace.surfaces import (
    Cos2sSpreading,
    Elfouhaily,
    IttcSpreading,
    Jonswap,
    MitsuyasuSpreading,
    Tma,
)

viz.use_style()
spectra = {
    "JONSWAP, fetch 30 km": Jonswap(wind_speed=13.0, fetch=30e3),
    "Elfouhaily, fetch 30 km": Elfouhaily(wind_speed=13.0, fetch=30e3),
    "TMA, 10 m deep": Tma(wind_speed=13.0, fetch=30e3, depth=10.0),
}
omega = np.linspace(0.2, 4.0, 500)
values = [spectrum(omega) for spectrum in spectra.values()]
for name, spectrum in zip(spectra, values, strict=True):
    print(f"{name:24} Hs = {4.0 * np.sqrt(np.trapezoid(spectrum, omega)):.2f} m up to 4 rad/s")
ax = viz.plot_spectrum(
    xr.Dataset({"spectrum": (("name", "omega"), values)}, {"name": list(spectra), "omega": omega})
)
ax.set_title("wind 13 m/s")
viz.save_picture(ax.figure, "spectra.png")

# %%
# Directional spreadings at the peak.

theta = np.radians(np.linspace(-180.0, 180.0, 361))
jonswap = spectra["JONSWAP, fetch 30 km"]
state = {"omega_p": jonswap.omega_p, "wind_speed": 13.0}
spreadings = {
    "ITTC": IttcSpreading(),
    "cos-2s, s = 10": Cos2sSpreading(s=10.0),
    "Mitsuyasu": MitsuyasuSpreading(),
}
values = [s.density(jonswap.omega_p, theta, **state) for s in spreadings.values()]
ax = viz.plot_spreading(
    xr.Dataset(
        {"spreading": (("name", "theta"), values)}, {"name": list(spreadings), "theta": theta}
    )
)
ax.set_title("at the peak, wind 13 m/s")
viz.save_picture(ax.figure, "spreading.png")
