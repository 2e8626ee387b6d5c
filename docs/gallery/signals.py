"""
Pulses, eye diagram and bit error rates
=======================================

Arrival times of the light in clear and in turbid water.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/eye.png'

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.comms.ook import OokLink
from meshtrace.surfaces import JonswapSea

viz.use_style()
sea = JonswapSea(wind_speed=5.0, seed=7)
responses = {}
for name, b in (("clear, b = 0.037 1/m", 0.037), ("turbid, b = 0.3 1/m", 0.3)):
    link = mt.Link(water=mt.Water(a=0.114, b=b))
    result = mt.simulate(link, sea, photons=20_000, record=[mt.Arrivals()])
    responses[name] = mt.impulse_response(result, bin_width=2.5e-10)
ax = viz.plot_impulse_response(responses)
viz.save_picture(ax.figure, "impulse_response.png")

# %%
# The eye diagram at the power for a bit error rate of 1e-3, and the rate over the received power.

receiver = OokLink(bit_rate=5e6)
needed = receiver.required_power(1e-3)
print(f"power for a bit error rate of 1e-3: {10.0 * np.log10(needed / 1e-3):.1f} dBm")
ax = viz.plot_eye(receiver.eye(needed))
viz.save_picture(ax.figure, "eye.png")

power = 1e-3 * 10.0 ** (np.linspace(-82.0, -50.0, 60) / 10.0)
rates = (1e6, 5e6, 1e7)
ber = [OokLink(bit_rate=rate).ber(power) for rate in rates]
names = [f"{rate / 1e6:g} Mbit/s" for rate in rates]
data = xr.Dataset(
    {"ber": (("rate", "received_power"), ber)}, {"rate": names, "received_power": power}
)
ax = viz.plot_ber(data)
viz.save_picture(ax.figure, "ber.png")

# %%
# Averaged over seas, over the depth of the LED.

depths = [24.0, 28.0, 32.0, 36.0, 40.0, 44.0]
performance = mt.link_performance(
    mt.Link(), sea, depths=depths, bit_rate=[5e6, 1e7], realizations=12, photons=512
)
print(performance)
ax = viz.plot_performance(performance)
viz.save_picture(ax.figure, "performance.png")
