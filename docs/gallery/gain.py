"""Gain over a moving sea and over many seas, its statistics, and the fates of the light."""

from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import resolved_sea


def main(folder: Path) -> None:
    viz.use_style()
    link, sea = mt.Link(), resolved_sea(5.0, fetch=30e3, seed=7)  # all waves that light feels
    series = mt.time_series(link, sea, np.arange(0.0, 4.0, 0.02), photons=1024)
    ax = viz.plot_gain_series(series)
    viz.save_picture(ax.figure, folder / "gain_series.png")
    ax = viz.plot_autocorrelation(series.fading())
    viz.save_picture(ax.figure, folder / "gain_autocorrelation.png")

    many = mt.ensemble(link, 200, sea, photons=1024)
    ax = viz.plot_gain_pdf(many)
    viz.save_picture(ax.figure, folder / "gain_pdf.png")
    ax = viz.plot_gain_cdf(many)
    viz.save_picture(ax.figure, folder / "gain_cdf.png")

    result = mt.simulate(link, sea, estimator="analog", photons=100_000)
    ax = viz.plot_fates(result)
    viz.save_picture(ax.figure, folder / "fates.png")


if __name__ == "__main__":
    main(Path(__file__).parent)
