"""The bubble layer at three winds: how it scatters over depth, and what it looks like."""

from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path) -> None:
    viz.use_style()
    layers = {f"{u:g} m/s": mt.HallNovarini(wind_speed=u) for u in (5.0, 9.0, 13.0)}
    depth = np.linspace(0.0, 10.0, 201)
    for quantity, method in (("b_bub", "b"), ("n_bubbles", "number_density")):
        curves = {name: getattr(layer, method) for name, layer in layers.items()}
        ax = viz.plot_bubble_profile(curves, depth, quantity=quantity)
        ax.figure.savefig(folder / f"bubbles_{quantity}.png")

    link = mt.Link(bubbles=layers["13 m/s"], transmitter=mt.Led(depth=4.0))
    sea = JonswapSea(wind_speed=13.0, fetch=30e3, seed=7)
    plotter = viz.scene(link, sea, extent=6.0, uav=False, off_screen=True, window_size=(1200, 750))
    viz.save_picture(plotter, folder / "bubbles.png")
    plotter.close()


if __name__ == "__main__":
    main(Path(__file__).parent)
