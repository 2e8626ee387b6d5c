"""Arrival of the light, eye diagram, and bit error ratios."""

from pathlib import Path

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.comms.ook import OokLink
from meshtrace.surfaces import JonswapSea


def main(folder: Path) -> None:
    viz.use_style()
    sea = JonswapSea(wind_speed=5.0, seed=7)
    responses = {}
    for name, b in (("clear, b = 0.037 1/m", 0.037), ("turbid, b = 0.3 1/m", 0.3)):
        link = mt.Link(water=mt.Water(a=0.114, b=b))
        result = mt.simulate(link, sea, photons=20_000, record=[mt.Arrivals()])
        responses[name] = mt.impulse_response(result, bin_width=2.5e-10)
    ax = viz.plot_impulse_response(responses)
    viz.save_picture(ax.figure, folder / "impulse_response.png")

    receiver = OokLink(bit_rate=5e6)
    ax = viz.plot_eye(receiver.eye(receiver.required_power(1e-3)))
    viz.save_picture(ax.figure, folder / "eye.png")

    power = 1e-3 * 10.0 ** (np.linspace(-82.0, -50.0, 60) / 10.0)
    rates = (1e6, 5e6, 1e7)
    ber = [OokLink(bit_rate=rate).ber(power) for rate in rates]
    names = [f"{rate / 1e6:g} Mbit/s" for rate in rates]
    data = xr.Dataset(
        {"ber": (("rate", "received_power"), ber)}, {"rate": names, "received_power": power}
    )
    ax = viz.plot_ber(data)
    viz.save_picture(ax.figure, folder / "ber.png")

    depths = [24.0, 28.0, 32.0, 36.0, 40.0, 44.0]
    performance = mt.link_performance(
        mt.Link(), sea, depths=depths, bit_rate=[5e6, 1e7], realizations=12, photons=512
    )
    ax = viz.plot_performance(performance)
    viz.save_picture(ax.figure, folder / "performance.png")


if __name__ == "__main__":
    main(Path(__file__).parent)
