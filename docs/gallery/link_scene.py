"""The default link over a sea at 13 m/s: LED, surface, bubbles, and a tilted receiver."""

from pathlib import Path

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path) -> None:
    link = mt.Link(
        bubbles=mt.HallNovarini(wind_speed=13.0),
        receiver=mt.Receiver(tilt_deg=14.0),
    )
    sea = JonswapSea(wind_speed=13.0, fetch=30e3, omega_max=9.0, seed=7)
    style = viz.SceneStyle(off_screen=True, window_size=(1200, 750))
    plotter = viz.scene(link, sea, style=style)
    viz.save_picture(plotter, folder / "link_scene.png")
    plotter.close()


if __name__ == "__main__":
    main(Path(__file__).parent)
