"""A moving sea with its gain, as a movie."""

from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path, frames: int = 300) -> None:
    link, sea = mt.Link(), JonswapSea(wind_speed=5.0, omega_max=9.0, seed=7)
    times = np.arange(frames) / 30.0  # 10 s at natural speed
    viz.save_movie(link, sea, times, folder / "movie.mp4", received=30, quality=2.8)


if __name__ == "__main__":
    main(Path(__file__).parent)
