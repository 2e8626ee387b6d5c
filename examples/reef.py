"""A coral reef under the paper's link: a mesh made here, as a file and as a body of the link.

`python examples/reef.py FACETS` makes the reef of about that many facets, 80000 by default.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

import meshtrace as mt
from meshtrace.surfaces import SpectralSea, from_trimesh

HALF = 10.0  # half-width of the reef [m]
rng = np.random.default_rng(24)


def bumps(n: int) -> np.ndarray:
    """Return heights (n, n) of standard deviation 1 whose spectrum falls as k^-3.6: a fractal."""
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(n, 1.0 / n), np.fft.fftfreq(n, 1.0 / n)))
    amplitude = np.zeros_like(k)
    amplitude[k > 0.0] = k[k > 0.0] ** -1.8
    heights = np.fft.ifft2(amplitude * np.fft.fft2(rng.normal(size=(n, n)))).real
    return heights / heights.std()


def head(x: float, y: float, z: float, radius: float, subdivisions: int) -> trimesh.Trimesh:
    """Return a coral head: a sphere with knobs, which overhangs the floor that it stands on."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    axes = rng.normal(size=(60, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    knobs = np.exp(-40.0 * (1.0 - ball.vertices @ axes.T)).sum(axis=1)
    ball.vertices *= radius * (0.8 + 0.25 * knobs)[:, None] * (1.0, 1.0, 0.8)
    ball.apply_translation((x, y, z + 0.4 * radius))
    return ball


def reef(facets: int) -> trimesh.Trimesh:
    """Return a reef about z = 0 of about the given number of facets, most of them coral heads."""
    n = max(int(np.sqrt(facets / 8.0)), 8)
    axis = np.linspace(-HALF, HALF, n)
    height = 0.5 * bumps(n)
    floor = from_trimesh((axis, axis, height)).to_trimesh()
    # some 40 to 160 heads, of 20 facets times 4 a subdivision
    subdivisions = max(int(np.log(0.75 * facets / 40.0 / 20.0) / np.log(4.0)), 0)
    count = int(0.75 * facets / (20 * 4**subdivisions))
    i, j = rng.integers(0, n, (2, count))
    sizes = 0.2 + 0.4 * rng.pareto(2.5, count).clip(max=2.5)
    places = zip(axis[i], axis[j], height[i, j], sizes, strict=True)
    return trimesh.util.concatenate([floor, *(head(*p, subdivisions) for p in places)])


def main() -> None:
    """Compare the light of a lamp above the reef with that without it."""
    facets = int(sys.argv[1]) if len(sys.argv) > 1 else 80_000
    sea = SpectralSea(spectrum=mt.surfaces.Jonswap(wind_speed=5.0), seed=1)
    # light that comes back from the reef is weak: a wide lens shows it
    link = mt.Link(water=mt.Water(a=0.05, b=0.04), receiver=mt.Receiver(radius=0.5, fov_deg=180.0))

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "reef.ply"
        reef(facets).export(file)
        start = time.process_time()
        # living corals are brown: a table of wavelength [nm] and albedo
        corals = [(400.0, 0.05), (470.0, 0.08), (560.0, 0.14), (700.0, 0.3)]
        body = mt.Body(file, albedo=corals, position=(0.0, 0.0, -12.5))
        print(f"{body.n_facets} facets, read in {time.process_time() - start:.1f} CPU s")
        down = link.replace("transmitter.zenith_deg", 180.0)
        for name, case in (("lamp up", link), ("lamp down", down)):
            for bodies in ((), (body,)):
                start = time.process_time()
                r = mt.simulate(case.replace(objects=bodies), sea, rtol=0.02, seed=1)
                spent = time.process_time() - start
                words = "with the reef" if bodies else "without it"
                gain = f"{r.gain:.3e} +- {r.gain_stderr:.1e}"
                print(f"{name}, {words}: gain {gain}, {spent:.1f} CPU s")


if __name__ == "__main__":
    main()
