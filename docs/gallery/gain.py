"""
Fading over time and over seas
==============================

The gain over a moving sea at 5 m/s that resolves all waves that light feels, with bands of two
standard errors, and its autocorrelation over 40 s: without memory it would stay in the grey band.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/gain_series.png'

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import resolved_sea

viz.use_style()
link, sea = mt.Link(), resolved_sea(5.0, fetch=30e3, seed=7)
series = mt.time_series(link, sea, np.arange(0.0, 40.0, 0.04), photons=256)
print(series)
ax = viz.plot_gain_series(series.to_dataset().isel(time=slice(100)))
viz.save_picture(ax.figure, "gain_series.png")
ax = viz.plot_autocorrelation(series.fading())
viz.save_picture(ax.figure, "gain_autocorrelation.png")

# %%
# The distribution over 200 independent seas, with fitted laws.

many = mt.ensemble(link, 200, sea, photons=512)
print(many)
ax = viz.plot_gain_pdf(many)
viz.save_picture(ax.figure, "gain_pdf.png")
ax = viz.plot_gain_cdf(many)
viz.save_picture(ax.figure, "gain_cdf.png")

# %%
# The fates of the light, from individual photons.

result = mt.simulate(link, sea, estimator="analog", photons=100_000, waves="fading")
ax = viz.plot_fates(result)
viz.save_picture(ax.figure, "fates.png")
