"""Gain over the plane of the receiver: as a map, and in the scene."""

from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path) -> None:
    viz.use_style()
    link, sea = mt.Link(), JonswapSea(wind_speed=5.0, seed=7)
    coverage = mt.coverage_map(
        link, sea, extent=5.0, step=0.25, times=np.arange(0.0, 10.0, 2.0), photons=200_000
    )
    ax = viz.plot_coverage(coverage, decibel=True)
    viz.save_picture(ax.figure, folder / "coverage.png")

    style = viz.SceneStyle(uav=False, off_screen=True)
    plotter = viz.scene(link, sea, coverage=coverage, style=style)
    viz.save_picture(plotter, folder / "coverage_scene.png")
    plotter.close()


if __name__ == "__main__":
    main(Path(__file__).parent)
