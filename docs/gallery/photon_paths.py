"""Photon paths by fate, and refraction of received light at the surface, close up."""

from dataclasses import replace
from pathlib import Path

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path) -> None:
    link = mt.Link(
        water=mt.Water(a=0.114, b=0.12),
        bubbles=mt.HallNovarini(wind_speed=8.0),
        transmitter=mt.Led(depth=8.0, half_angle_deg=12.0),
    )
    sea = JonswapSea(wind_speed=8.0, omega_max=8.0, seed=3)

    style = viz.SceneStyle(off_screen=True)
    gain = mt.simulate(link, sea)
    plotter = viz.scene(link, sea, paths=80, received=30, gain=gain, style=style)
    viz.save_picture(plotter, folder / "photon_paths.png")
    plotter.close()

    wide = link.model_copy(update={"transmitter": mt.Led(depth=8.0, half_angle_deg=30.0)})
    plotter = viz.scene(
        wide,
        sea,
        paths=150,
        received=20,
        style=replace(style, edges=True, extent=2.0, spacing=0.1, opacity=0.5),
    )
    viz.save_picture(plotter, folder / "photon_paths_surface.png")
    plotter.close()


if __name__ == "__main__":
    main(Path(__file__).parent)
