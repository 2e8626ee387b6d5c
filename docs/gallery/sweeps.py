"""Gain over depth at two half-angles, and how it converges with the mesh spacing."""

from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea, SinusoidalSea


def main(folder: Path) -> None:
    viz.use_style()
    sea = JonswapSea(wind_speed=5.0, seed=7)
    depths, gains, errors = np.arange(5.0, 41.0, 5.0), {}, {}
    for half_angle in (5.0, 20.0):
        name = f"half-angle {half_angle:g}°"
        runs = [
            mt.simulate(mt.Link(transmitter=mt.Led(depth=d, half_angle_deg=half_angle)), sea)
            for d in depths
        ]
        gains[name], errors[name] = zip(*((r.gain, r.gain_stderr) for r in runs), strict=True)
    ax = viz.plot_sweep(depths, gains, errors, along="depth")
    ax.figure.savefig(folder / "sweep_depth.png")

    spacings, curves = np.array([0.4, 0.3, 0.2, 0.15]), {}
    for wavelength in (4.0, 8.0):
        wave = SinusoidalSea(amplitude=0.02 * wavelength, wavelength=wavelength)
        finest, *gain = [
            mt.simulate(mt.Link(), wave, spacing=s, photons=4096).gain_ballistic
            for s in (0.02, *spacings)
        ]
        curves[f"waves of {wavelength:g} m"] = np.abs(np.array(gain) / finest - 1.0)
    ax = viz.plot_convergence(spacings, curves, quantity="relative error of the unscattered gain")
    ax.figure.savefig(folder / "convergence.png")


if __name__ == "__main__":
    main(Path(__file__).parent)
