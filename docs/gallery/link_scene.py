"""The default link over seas at 13 and 5 m/s: LED, surface, bubbles, a tilted receiver, light."""

from pathlib import Path

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path) -> None:
    receiver = mt.Receiver(tilt_deg=14.0, tilt_azimuth_deg=-60.0)
    for wind_speed, name in ((13.0, "link_scene.png"), (5.0, "link_scene_5.png")):
        link = mt.Link(receiver=receiver).in_wind(wind_speed)
        sea = JonswapSea(wind_speed=wind_speed, fetch=30e3, omega_max=9.0, seed=7)
        gain = mt.simulate(link, sea)
        style = viz.SceneStyle(footprint=False, off_screen=True)
        plotter = viz.scene(link, sea, received=40, gain=gain, style=style)
        viz.save_picture(plotter, folder / name)
        plotter.close()


if __name__ == "__main__":
    main(Path(__file__).parent)
