"""Reflection of sun and sky by the sea: analog light from the air over meshes with tilts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from meshtrace.engine.simulate import simulate
from meshtrace.link import CardioidalSky, IrradiancePlanes, Link, Receiver, Sun, UniformSky
from meshtrace.mesh import MeshSource
from meshtrace.optics.water import Water
from meshtrace.results.tallies import error_of_groups
from meshtrace.surfaces import Elfouhaily, FlatSea, SpectralSea

from .suite import MeasuredRow

_SEAS, _PHOTONS = 8, 16_384  # photons of each sea
_HALF_WIDTH = 20.0  # [m], of the lit square
_SKIES = {"isotropic": UniformSky, "cardioidal": CardioidalSky}


@cache
def reflected(
    light: str, altitude_deg: float, wind_speed: float, photons: int
) -> tuple[float, float]:
    """Return the share of the irradiance that the surface reflects, with its standard error.

    `light` is "sun", or a sky; what it does not reflect a black floor takes in water that neither
    absorbs nor scatters. Means of seas with the slopes of Cox and Munk.
    """
    source = (
        Sun(zenith_deg=90.0 - altitude_deg, half_width=_HALF_WIDTH)
        if light == "sun"
        else _SKIES[light](half_width=_HALF_WIDTH)
    )
    link = Link(
        water=Water(a=0.0, b=0.0, n=1.34, bottom_depth=20.0, bottom_albedo=0.0),
        transmitter=source,
        receiver=Receiver(height=30.0),
        planes=IrradiancePlanes(depths=(10.0,)),
    )

    def transmitted(sea: MeshSource, seed: int) -> float:
        run = simulate(link, sea, estimator="analog", photons=photons, seed=seed)
        assert run.planes is not None
        return float(run.planes.e_d[0])

    seas: list[MeshSource] = [FlatSea()] * _SEAS
    if wind_speed > 0.0:
        spectrum = Elfouhaily(wind_speed=wind_speed)
        seas = [
            SpectralSea(spectrum=spectrum, spreading="elfouhaily", mss="cox-munk", seed=i)
            for i in range(_SEAS)
        ]
    found = 1.0 - np.array([transmitted(sea, i + 1) for i, sea in enumerate(seas)])
    return float(found.mean()), float(error_of_groups(found))


def sea_albedo(
    rows: Sequence[MeasuredRow],
    photons: float,
    wind_speed: float,
    direct_share: float,
    sky: str,
    water_light: float,
) -> tuple[list[float], list[float]]:
    """Return the albedo, p A_sun + (1 - p) A_sky + A_w, with p = 0 under an overcast sky."""
    each = max(int(_PHOTONS * photons), 1024)
    diffuse, diffuse_error = reflected(sky, 0.0, wind_speed, each)
    values, errors = [], []
    for row in rows:
        p = direct_share if row.series == "clear" else 0.0
        sun, error = reflected("sun", row.at, wind_speed, each) if p else (0.0, 0.0)
        values.append(p * sun + (1.0 - p) * diffuse + water_light)
        errors.append(float(np.hypot(p * error, (1.0 - p) * diffuse_error)))
    return values, errors
