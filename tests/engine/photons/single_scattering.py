"""Light scattered once under a flat sea, by quadrature: written apart from the engine.

Rays leave four points of the aperture into the field of view, are refracted by Snell's law, and
the light that the water scatters into each of them is integrated along it. Nothing of the package
is used: formulas of the phase function, of Fresnel and of the lamp are repeated here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class Setting:
    """A flat sea, a lamp in the origin's plumb line unless `offset`, a disk in the air."""

    a: float = 0.114
    b: float = 0.037
    n: float = 1.33
    depth: float = 10.0
    half_angle_deg: float | None = 10.0  # None: isotropic
    lamp_zenith_deg: float = 0.0  # leaning to +x
    height: float = 5.0
    radius: float = 0.05
    fov_deg: float = 60.0
    offset: float = 0.0  # of the receiver along +x
    tilt_deg: float = 0.0  # line of sight from nadir towards the azimuth
    azimuth_deg: float = 0.0
    g: float | None = None  # Henyey-Greenstein; None: Fournier-Forand 1.1, 3.5835


def fournier_forand(theta, n=1.1, mu=3.5835):
    """Fournier and Jonasz 1999, eq. 3, as it is printed."""
    v = (3.0 - mu) / 2.0
    s2 = np.sin(theta / 2.0) ** 2
    delta = 4.0 * s2 / (3.0 * (n - 1.0) ** 2)
    delta_180 = 4.0 / (3.0 * (n - 1.0) ** 2)
    dv = delta**v
    first = v * (1.0 - delta) - (1.0 - dv) + (delta * (1.0 - dv) - v * (1.0 - delta)) / s2
    last = (1.0 - delta_180**v) / (16.0 * np.pi * (delta_180 - 1.0) * delta_180**v)
    return first / (4.0 * np.pi * (1.0 - delta) ** 2 * dv) + last * (3.0 * np.cos(theta) ** 2 - 1.0)


def henyey_greenstein(theta, g):
    return (1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * np.cos(theta)) ** 1.5)


def emitted(setting, w):
    """Return the intensity per unit power of unit directions (..., 3)."""
    if setting.half_angle_deg is None:
        return np.full(w.shape[:-1], 1.0 / (4.0 * np.pi))
    m = -math.log(2.0) / math.log(math.cos(math.radians(setting.half_angle_deg)))
    lean = math.radians(setting.lamp_zenith_deg)
    cosine = np.maximum(w[..., 0] * math.sin(lean) + w[..., 2] * math.cos(lean), 0.0)
    return (m + 1.0) / (2.0 * np.pi) * cosine**m


def directions(setting, nodes):
    """Return rays into the field of view, against the light, and their weights cos dOmega."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    half = math.radians(setting.fov_deg) / 2.0
    u = 0.5 * (1.0 + x) * math.sin(half) ** 2  # sin^2: cos sin dpsi = du / 2
    phi = 2.0 * np.pi * (np.arange(nodes) + 0.5) / nodes
    du = 0.5 * weight * math.sin(half) ** 2
    sin, cos = np.sqrt(u)[:, None], np.sqrt(1.0 - u)[:, None] * np.ones(nodes)
    local = np.stack([sin * np.cos(phi), sin * np.sin(phi), -cos], axis=-1)
    tilt, azimuth = math.radians(setting.tilt_deg), math.radians(setting.azimuth_deg)
    # lean the nadir towards +x by the tilt, then turn to the azimuth
    lean = np.array(
        [
            [math.cos(tilt), 0.0, -math.sin(tilt)],
            [0.0, 1.0, 0.0],
            [math.sin(tilt), 0.0, math.cos(tilt)],
        ]
    )
    turn = np.array(
        [
            [math.cos(azimuth), -math.sin(azimuth), 0.0],
            [math.sin(azimuth), math.cos(azimuth), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    rotation = turn @ lean
    w = local @ rotation.T
    axes = rotation @ np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    return w.reshape(-1, 3), (du[:, None] * np.full(nodes, np.pi / nodes)).ravel(), axes


def single_scattering(setting: Setting, nodes: int = 64) -> float:
    """Return the gain of the light scattered once; `nodes` in each of three variables."""
    w, weight, axes = directions(setting, nodes)
    below = w[:, 2] < 0.0
    w, weight = w[below], weight[below]
    n = setting.n
    # Snell and Fresnel on still water
    cos_air = -w[:, 2]
    cos_water = np.sqrt(1.0 - (1.0 - cos_air**2) / n**2)
    rs = (cos_air - n * cos_water) / (cos_air + n * cos_water)
    rp = (n * cos_air - cos_water) / (n * cos_air + cos_water)
    through = (1.0 - 0.5 * (rs**2 + rp**2)) / n**2
    d = np.column_stack([w[:, 0] / n, w[:, 1] / n, -cos_water])
    lamp = np.array([0.0, 0.0, -setting.depth])
    center = np.array([setting.offset, 0.0, setting.height])
    total = 0.0
    for k in range(4):  # exact for cubic functions on a disk
        spot = axes @ np.array([math.cos(0.5 * np.pi * k), math.sin(0.5 * np.pi * k)])
        x = center + setting.radius / math.sqrt(2.0) * spot
        o = x + (x[2] / cos_air)[:, None] * w
        total += float(np.sum(weight * through * line(setting, o, d, lamp, nodes))) / 4.0
    return np.pi * setting.radius**2 * total


def line(setting, o, d, lamp, nodes):
    """Integrate the light scattered once into rays over the scattering angle."""
    x, gauss = np.polynomial.legendre.leggauss(nodes)
    to_lamp = lamp - o
    t0 = np.sum(to_lamp * d, axis=1)
    distance = np.linalg.norm(to_lamp - t0[:, None] * d, axis=1)
    first = np.arctan2(distance, t0)
    result = np.zeros(len(o))
    edges = np.linspace(0.0, 1.0, 4)
    for low, high in pairwise(edges):
        for k in range(nodes):
            part = low + (high - low) * 0.5 * (1.0 + x[k])
            # theta = first * (pi / first)^part is fine where the phase function is steep
            stretch = np.log(np.pi / first)
            theta = first * np.exp(part * stretch)
            dtheta = 0.5 * (high - low) * gauss[k] * theta * stretch
            t = t0 - distance / np.tan(theta)
            r = distance / np.sin(theta)
            p = o + t[:, None] * d
            light = emitted(setting, (p - lamp) / r[:, None])
            beta = (
                fournier_forand(theta) if setting.g is None else henyey_greenstein(theta, setting.g)
            )
            # behind the last points the path is long and the exponential has ended
            result += dtheta * beta * light * np.exp(-(setting.a + setting.b) * (t + r))
    return setting.b / distance * result
