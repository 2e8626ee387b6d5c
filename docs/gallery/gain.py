"""Gain over a moving sea and over many seas, its statistics, and the fates of the light."""

from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path) -> None:
    viz.use_style()
    link, sea = mt.Link(), JonswapSea(wind_speed=5.0, seed=7, jitter=True)
    series = mt.time_series(link, sea, np.arange(0.0, 20.0, 0.2), photons=256)
    ax = viz.plot_gain_series(series)
    ax.figure.savefig(folder / "gain_series.png")
    ax = viz.plot_autocorrelation(series.fading())
    ax.figure.savefig(folder / "gain_autocorrelation.png")

    many = mt.ensemble(link, 150, sea, photons=256)
    ax = viz.plot_gain_pdf(many)
    ax.figure.savefig(folder / "gain_pdf.png")
    ax = viz.plot_gain_cdf(many)
    ax.figure.savefig(folder / "gain_cdf.png")

    result = mt.simulate(link, sea, estimator="analog", photons=100_000)
    ax = viz.plot_fates(result)
    ax.figure.savefig(folder / "fates.png")


if __name__ == "__main__":
    main(Path(__file__).parent)
