"""Background light of a receiver by day, and the bit error rate under it."""

import meshtrace as mt
from meshtrace.surfaces import JonswapSea

link = mt.Link(receiver=mt.Receiver(fov_deg=6.0))
sea = JonswapSea(wind_speed=5.0, seed=3)
day = mt.Daylight(direct=1.108, diffuse=0.236, sun_zenith_deg=60.0)  # W m-2 nm-1; needs no pvlib
print(mt.background(link, sea, day))

receiver = mt.OokLink().replace("optics.filter_width_nm", 0.5)
performance = mt.link_performance(
    link, sea, ook=receiver, daylight=day, realizations=2, photons=256
)
print(performance)
print(f"mean gain {performance.at().gain.value:.3e}")
