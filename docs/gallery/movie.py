"""A moving sea with its gain, as a movie."""

from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea


def main(folder: Path, frames: int = 11) -> None:
    link, sea = mt.Link(), JonswapSea(wind_speed=5.0, omega_max=9.0, seed=7)
    times = 0.4 * np.arange(frames)
    viz.save_movie(link, sea, times, folder / "movie.mp4", frame_rate=5.0, received=30)


if __name__ == "__main__":
    main(Path(__file__).parent)
