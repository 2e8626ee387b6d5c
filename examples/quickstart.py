"""Gain of a link under a JONSWAP sea, and the fates of its light."""

import meshtrace as mt
from meshtrace.surfaces import JonswapSea

sea = JonswapSea(wind_speed=13.0, fetch=30e3, seed=7)
link = mt.Link(
    bubbles=mt.HallNovarini(wind_speed=13.0),
    whitecaps=mt.Whitecaps(wind_speed=13.0),
)
gain = mt.simulate(link, sea, seed=1)
print(f"gain {gain.gain:.4e} +- {gain.gain_stderr:.1e}, {gain.gain_db:.2f} dB optical")

photons = mt.simulate(link, sea, estimator="analog", photons=1_000_000, seed=1)
print(f"gain {photons.gain:.4e} +- {photons.gain_stderr:.1e}, individual photons")
for fate, (number, weight) in photons.fates.items():
    print(f"{fate:12} {number:9,} photons {100.0 * weight:9.4f} % of the power")
