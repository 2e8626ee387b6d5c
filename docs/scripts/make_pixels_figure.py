"""Draw docs/_static/pixels.png: signal and background of the pixels of a receiver by day.

The link of docs/guides/arrays.md with 8 x 8 pixels and more rays.
"""

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
from places import STATIC

import meshtrace as mt
from meshtrace.viz import plot_pixels, use_style


def main():
    use_style()
    link = mt.Link(transmitter=mt.Led(depth=15), receiver=mt.Receiver(height=10, pixels=8))
    noon = mt.Daylight(direct=1.42, diffuse=0.295, sun_zenith_deg=40.0)
    sea = mt.surfaces.JonswapSea(wind_speed=5.0)
    signals = mt.studies.pixel_signals(link, sea, noon, bit_rate=1e6, rays=65_536)
    print(signals.summary())
    figure, ax = plt.subplots(figsize=(6.4, 3.2))
    plot_pixels(signals, ax=ax)
    figure.savefig(STATIC / "pixels.png", dpi=110)


if __name__ == "__main__":
    main()
