"""The same phases at 5 and at 13 m/s: as a viewer sees them, and by slope."""

from pathlib import Path

from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path) -> None:
    for wind_speed in (5.0, 13.0):
        sea = JonswapSea(wind_speed=wind_speed, fetch=30e3, omega_max=9.0, seed=7)
        mesh = sea.mesh(extent=30.0, spacing=0.12)
        for color, limit in (("water", None), ("slope", 0.25)):
            plotter = viz.scene(
                None,
                mesh,
                style=viz.SceneStyle(
                    color=color,
                    color_limit=limit,
                    opacity=1.0,
                    labels=False,
                    off_screen=True,
                    window_size=(1600, 1000),
                ),
            )
            viz.look(plotter, elevation_deg=24.0)
            viz.add_scale(plotter)
            viz.add_compass(plotter, wind_speed)
            viz.add_caption(plotter, f"JONSWAP sea, wind {wind_speed:g} m/s, fetch 30 km, seed 7")
            viz.save_picture(plotter, folder / f"surface_{wind_speed:g}_{color}.png")
            plotter.close()


if __name__ == "__main__":
    main(Path(__file__).parent)
