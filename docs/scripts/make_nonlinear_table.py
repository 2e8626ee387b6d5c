"""Fading of nonlinear seas: scintillation indices with the phases of a linear sea.

    python docs/scripts/make_nonlinear_table.py

Paraxial light of the default link lands at X = P + beta s(P). Slopes beyond the band blur it by a
Gaussian, the aperture by its disk. The index is the variance over a patch of receivers.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

import meshtrace as mt
from meshtrace import fading
from meshtrace.surfaces import Band, Elfouhaily, SpectralSea

WIND, FETCH = 5.0, 30e3
DEPTH, HEIGHT, RADIUS, INDEX = 10.0, 5.0, 0.05, 1.33
BETA = (INDEX - 1.0) * HEIGHT * DEPTH / (DEPTH + INDEX * HEIGHT)
APERTURE = RADIUS / (1.0 + INDEX * HEIGHT / DEPTH)
PIXEL = 0.02  # [m]
MARGIN = 1.5  # [m], of the patch: light that lands inside crosses no farther out
LINEAR = {"bins": (0.25, math.pi / 16)}
FEW_WAVES = {"bins": (0.5, math.pi / 8)}  # each pair of them has bound waves
KINDS = {
    "choppy": {"linear": LINEAR, "choppy": {**LINEAR, "choppy": True}},
    "second order": {"linear": FEW_WAVES, "second order": {**FEW_WAVES, "order": 2}},
}


def sea_up_to(
    omega_max: float, bins: tuple[float, float] = (0.25, math.pi / 16), **options: object
) -> SpectralSea:
    """Return the sea of the table, without a common period, by widths of its bins."""
    d_omega, d_theta = bins
    return SpectralSea(
        spectrum=Elfouhaily(wind_speed=WIND, fetch=FETCH),
        spreading="elfouhaily",
        mss="elfouhaily",
        waves=Band(omega_min=1.0, omega_max=omega_max, d_omega=d_omega, d_theta=d_theta),
        **options,
    )


def irradiance(sea: SpectralSea, omega_max: float, half: float, spacing: float) -> np.ndarray:
    """Return the irradiance over that of a flat sea, at the pixels of a patch of receivers."""
    axis = np.arange(-half - MARGIN, half + MARGIN, spacing)
    points, normals = sea.sheet(axis, axis)
    slopes = -normals[..., :2] / normals[..., 2:]
    landed = points[..., :2] + BETA * slopes
    area = _area(points[..., 0], points[..., 1], spacing)
    edges = np.arange(-half - MARGIN, half + MARGIN + 0.5 * PIXEL, PIXEL)
    pixels = np.histogram2d(
        landed[..., 0].ravel(), landed[..., 1].ravel(), bins=[edges, edges], weights=area.ravel()
    )[0]
    along, across = sea.slopes_beyond(omega_max)
    pixels = _blurred(pixels / PIXEL**2, BETA * math.sqrt(along), BETA * math.sqrt(across))
    cut = round(MARGIN / PIXEL)
    return pixels[cut:-cut, cut:-cut]


def _area(x: np.ndarray, y: np.ndarray, spacing: float) -> np.ndarray:
    """Return the area of the map around each point."""
    (xa, xb), (ya, yb) = np.gradient(x, spacing), np.gradient(y, spacing)
    return (xa * yb - xb * ya) * spacing**2


def _blurred(pixels: np.ndarray, along: float, across: float) -> np.ndarray:
    """Return the convolution with a Gaussian, with the aperture, and without that of the pixel."""
    k = 2.0 * math.pi * np.fft.fftfreq(pixels.shape[0], PIXEL)
    kx, ky = k[:, None], 2.0 * math.pi * np.fft.rfftfreq(pixels.shape[1], PIXEL)
    from scipy.special import j1

    z = np.maximum(np.hypot(kx, ky) * APERTURE, 1e-9)
    pixel = np.sinc(kx * PIXEL / (2.0 * math.pi)) * np.sinc(ky * PIXEL / (2.0 * math.pi))
    factor = 2.0 * j1(z) / z * np.exp(-0.5 * ((kx * along) ** 2 + (ky * across) ** 2)) / pixel
    return np.fft.irfft2(np.fft.rfft2(pixels) * factor, pixels.shape)


def measure(kind: str, omega_max: float, spacing: float, half: float, seas: int) -> np.ndarray:
    """Return mean and mean square of the irradiance of both seas, shape (seas, 2, 2)."""
    moments = np.empty((seas, 2, 2))
    for seed in range(seas):
        for j, options in enumerate(KINDS[kind].values()):
            sea = sea_up_to(omega_max, seed=seed, **options)
            light = irradiance(sea, omega_max, half, spacing)
            moments[seed, j] = light.mean(), np.mean(light**2)
    return moments


def rows(kind: str, omega_max: float, moments: np.ndarray) -> list[str]:
    """Return the lines of the table; standard errors by the jackknife over the seas."""
    seas = len(moments)

    def results(some: np.ndarray) -> np.ndarray:
        mean, square = np.moveaxis(some.mean(axis=0), -1, 0)
        index = square / mean**2 - 1.0
        return np.stack([index, index / index[0], mean / mean[0]])

    left_out = np.stack([results(np.delete(moments, i, axis=0)) for i in range(seas)])
    value = results(moments)
    error = np.sqrt((seas - 1) * left_out.var(axis=0))
    closed = fading.scintillation_of_spectrum(mt.Link(), sea_up_to(omega_max), omega_max)
    lines = []
    for j, name in enumerate(KINDS[kind]):
        cells = [f"{v:.4f} ± {e:.4f}" for v, e in zip(value[:, j], error[:, j], strict=True)]
        cells[1:] = cells[1:] if j else ["1", "1"]
        formula = "" if j else f"{closed:.4f}"
        lines.append(" | ".join([f"| {omega_max:g}", name, f"{seas}", formula, *cells]) + " |")
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", choices=KINDS, default="choppy")
    parser.add_argument("--omega-max", type=float, default=8.0)
    parser.add_argument("--spacing", type=float, default=0.04)
    parser.add_argument("--half", type=float, default=8.0)
    parser.add_argument("--seas", type=int, default=12)
    given = parser.parse_args()
    moments = measure(given.kind, given.omega_max, given.spacing, given.half, given.seas)
    print("\n".join(rows(given.kind, given.omega_max, moments)))


if __name__ == "__main__":
    main()
