"""Unscattered gains of W2A-1 by quadrature over the analytic surfaces: NumPy alone, no mesh, no rays.

With N = (-z_x, -z_y, 1) of the surface z(x, y), the lamp's intensity I and the transmittance T,

    gain = integral of I(d) exp(-c L) T (d . N) / L^2 [lands on the disk, within the view] dx dy
"""

import numpy as np

DEPTH_OF_AIR, INDEX = 5.0, 1.33  # height of the receiver [m], of the water over that of air
ORDER = -np.log(2.0) / np.log(np.cos(np.radians(10.0)))
REACH = 2.5  # half-width where light that reaches a disk unscattered crosses the surface [m]


def unscattered(waves, variant, attenuation, points=1000):
    """Return the unscattered gain through a surface of waves (amplitude, omega, kx, ky, phase)."""
    lines = [np.linspace(-REACH, REACH, 501)] * 2
    inside = _margin(*_crossing(waves, variant, *lines)[1:], variant, lines) > -3.0
    edges = [line[inside.any(axis=1 - i)][[0, -1]] for i, line in enumerate(lines)]
    steps = [(b - a) / points for a, b in edges]
    lines = [a + h * (np.arange(points) + 0.5) for (a, _), h in zip(edges, steps, strict=True)]
    density, *landing = _crossing(waves, variant, *lines, attenuation)
    # the share of a cell inside the edge of the disk or view, linear within the cell
    share = np.clip(_margin(*landing, variant, lines) + 0.5, 0.0, 1.0)
    return float(np.sum(share * density) * steps[0] * steps[1])


def _crossing(waves, variant, x, y, attenuation=0.0):
    """Return the density of light on a grid of the surface, landing radius and cosine in the air."""
    amplitude, _, kx, ky, phase = np.transpose(waves)
    along, across = np.exp(-1j * np.outer(x, kx)), np.exp(-1j * np.outer(ky, y))
    z, dx, dy = (
        (along * (factor * amplitude * np.exp(1j * phase)) @ across).real
        for factor in (1.0, -1j * kx, -1j * ky)
    )
    rise = z + variant["depth"]
    length = np.sqrt(x[:, None] ** 2 + y**2 + rise**2)
    d = np.stack([x[:, None] / length, y / length, rise / length])
    normal = np.stack([-dx, -dy, np.ones_like(z)])
    stretch = np.sqrt(np.sum(normal**2, axis=0))
    cos_i = np.sum(d * normal, axis=0) / stretch
    cos_t = np.sqrt(1.0 - INDEX**2 * (1.0 - cos_i**2))
    r_s = (INDEX * cos_i - cos_t) / (INDEX * cos_i + cos_t)
    r_p = (cos_i - INDEX * cos_t) / (cos_i + INDEX * cos_t)
    air = INDEX * d + (cos_t - INDEX * cos_i) * normal / stretch
    intensity = (ORDER + 1.0) / (2.0 * np.pi) * d[2] ** ORDER * np.exp(-attenuation * length)
    density = intensity * (1.0 - 0.5 * (r_s**2 + r_p**2)) * cos_i * stretch / length**2
    flight = (DEPTH_OF_AIR - z) / air[2]
    east = x[:, None] + flight * air[0] - variant["x"]
    return density, np.hypot(east, y + flight * air[1]), air[2]


def _margin(radius, cosine, variant, lines):
    """Return the distance within the edge of the disk and the view, in cells of the grid."""
    steps = [line[1] - line[0] for line in lines]
    edges = variant["radius"] - radius, cosine - np.cos(np.radians(0.5 * variant["fov_deg"]))
    found = []
    for edge in edges:
        slope = np.gradient(edge)
        found.append(edge / np.maximum(np.hypot(*slope), 1e-12 * max(steps)))
    return np.minimum(*found)
