"""Gain over depth at two half-angles, and its convergence with the mesh spacing."""

from pathlib import Path

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea, SinusoidalSea


def main(folder: Path) -> None:
    viz.use_style()
    sea = JonswapSea(wind_speed=5.0, seed=7)
    depths, half_angles = np.arange(5.0, 41.0, 5.0), (5.0, 20.0)
    runs = [
        [mt.simulate(mt.Link(transmitter=mt.Led(depth=d, half_angle_deg=a)), sea) for d in depths]
        for a in half_angles
    ]
    dims = ("half_angle", "depth")
    data = xr.Dataset(
        {
            "gain": (dims, [[r.gain for r in row] for row in runs]),
            "gain_stderr": (dims, [[r.gain_stderr for r in row] for row in runs]),
        },
        {"half_angle": [f"half-angle {a:g}°" for a in half_angles], "depth": depths},
    )
    ax = viz.plot_sweep(data)
    viz.save_picture(ax.figure, folder / "sweep_depth.png")

    wave = SinusoidalSea(amplitude=0.12, wavelength=6.0)
    study = mt.convergence_study(mt.Link(), wave, (0.8, 0.6, 0.4, 0.3), ("vertex",), photons=512)
    ax = viz.plot_convergence(study)
    viz.save_picture(ax.figure, folder / "convergence.png")


if __name__ == "__main__":
    main(Path(__file__).parent)
