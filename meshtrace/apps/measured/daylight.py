"""Sun and sky in the water, and their reflection by the sea, by analog photons."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from meshtrace import MeshSource, simulate
from meshtrace.link import CardioidalSky, IrradiancePlanes, Link, Receiver, Sun, UniformSky
from meshtrace.optics import Water
from meshtrace.optics.spectra import coefficients
from meshtrace.results.tallies import Planes, error_of_groups
from meshtrace.surfaces import Elfouhaily, FlatSea, SpectralSea

from .beams import phase_of
from .suite import DATA, MeasuredRow

_TOP = 0.01  # [m], depth that stands for that just below the surface
_PHOTONS, _RADIANCE_PHOTONS = 2**16, 2**21


@cache
def light_below(
    a: float,
    b: float,
    phase: str,
    zenith_deg: float,
    depths: tuple[float, ...],
    photons: int,
    cosines: int = 0,
) -> Planes:
    """Return irradiances at depths of deep water, under sun or (zenith angle < 0) uniform sky."""
    water = Water(a=a, b=b, n=1.34, phase=phase_of(phase), bottom_depth=depths[-1] + 2.0 / (a + b))
    link = Link(
        water=water,
        transmitter=Sun(zenith_deg=zenith_deg) if zenith_deg >= 0.0 else UniformSky(),
        planes=IrradiancePlanes(depths=depths, n_cosines=cosines),
    )
    # still water, cut where the sideways walk of the light has no effect
    mesh = FlatSea().mesh(0.0, 1e4, 5e3)
    run = simulate(link, mesh, estimator="analog", photons=photons, seed=7, roulette=1e-5)
    assert run.planes is not None
    return run.planes


def attenuation(planes: Planes) -> tuple[float, float]:
    """Return K = ln(E_d1 / E_d2) / (z2 - z1) and its error, neglecting their correlation."""
    way, e_d = np.diff(planes.depth)[0], planes.e_d
    return float(np.log(e_d[0] / e_d[1]) / way), float(np.hypot(*(planes.e_d_stderr / e_d)) / way)


def diffuse_attenuation(
    row: MeasuredRow, photons: float, zenith_deg: float, phase: str, depth: float
) -> tuple[float, float]:
    """Return K_d from the surface to a depth for the series' Jerlov type at `at` nm."""
    a, b = map(float, coefficients(f"jerlov-{row.series}", row.at))
    planes = light_below(a, b, phase, zenith_deg, (_TOP, depth), int(_PHOTONS * photons))
    return attenuation(planes)


def broadband(
    row: MeasuredRow, photons: float, type: str, zenith_deg: float, weight: str, phase: str
) -> tuple[float, float]:
    """Return E_d(z) / E_d(0) over 400 to 1000 nm; none of the light beyond 700 nm reaches `at`.

    The weight of the sensor is flat in "energy" or in "photons"; water of a Jerlov type.
    """
    table = np.loadtxt(DATA / "paulson-simpson" / "spectrum.csv", delimiter=",", skiprows=1)
    nm, spectrum = table.T
    spectrum = spectrum * (nm if weight == "photons" else 1.0)
    depths, i, total, variance = (_TOP, *row.along), 1 + row.along.index(row.at), 0.0, 0.0
    # all of the light at the surface counts, also what the water absorbs within centimetres
    for wavelength, share in zip(nm, spectrum / spectrum.sum(), strict=True):
        if wavelength > 700.0:
            continue
        a, b = map(float, coefficients(f"jerlov-{type}", wavelength))
        planes = light_below(a, b, phase, zenith_deg, depths, int(_PHOTONS * photons))
        total += share * planes.e_d[i] / planes.e_d[0]
        variance += (share * planes.e_d_stderr[i] / planes.e_d[0]) ** 2
    return total, math.sqrt(variance)


def clear_sea_radiance(
    row: MeasuredRow, photons: float, a: float, b: float, phase: str, zenith_deg: float
) -> tuple[float, float]:
    """Return relative variations of upward radiance, mean cosine and Q in clear water [%].

    "radiance": half the range of the azimuthal mean over 0 to 40 deg from nadir in the air, over
    its mean; "cosine": standard deviation of E_d / E_od over depths of 5 to 40 m, over its mean;
    "q": range of E_u / L_u(nadir) over the depths, over its least value.
    """
    depths = (_TOP, 5.0, 10.0, 20.0, 40.0)
    shots = int(_RADIANCE_PHOTONS * photons)
    planes = light_below(a, b, phase, zenith_deg, depths, shots, cosines=32)
    assert planes.radiance is not None
    assert planes.radiance_stderr is not None
    up, error = planes.radiance[:, :, 0], planes.radiance_stderr[:, :, 0]
    # two bins of 1 / 16 from the nadir on end at 29 deg in the water, 40 deg in the air
    at_top, noise = up[0, :2], error[0, :2]
    spread = 0.5 * np.ptp(at_top) / at_top.mean()
    cosine = planes.e_d[1:] / planes.e_od[1:]
    q = planes.e_u / up[:, 0]
    # of a range the error is at most that of its worse end
    q_error = float((error[:, 0] / up[:, 0]).max())
    values = {
        "radiance": (spread, float(np.hypot(*noise) / 2.0 / at_top.mean())),
        "cosine": (float(cosine.std(ddof=1) / cosine.mean()), 0.0),
        "q": (float(np.ptp(q) / q.min()), q_error),
    }
    value, stderr = values[row.series]
    return 100.0 * value, 100.0 * stderr


def asymptotic_ratio(
    row: MeasuredRow, photons: float, albedo: float, phase: str, first: float
) -> tuple[float, float]:
    """Return K / c of diffuse light from `first` to `first` + 5 attenuation lengths."""
    depths = (first, first + 5.0)
    planes = light_below(1.0 - albedo, albedo, phase, -1.0, depths, int(4 * _PHOTONS * photons))
    return attenuation(planes)


_SEAS, _OF_SEA = 8, 16_384  # photons of each sea
_HALF_WIDTH = 20.0  # [m], of the lit square
_SKIES = {"isotropic": UniformSky, "cardioidal": CardioidalSky}


@cache
def reflected(
    incident: str, altitude_deg: float, wind_speed: float, photons: int
) -> tuple[float, float]:
    """Return the share of the irradiance that the surface reflects, with its standard error.

    `light` is "sun", or a sky; what it does not reflect a black floor takes in water that neither
    absorbs nor scatters. Means of seas with the slopes of Cox and Munk.
    """
    source = (
        Sun(zenith_deg=90.0 - altitude_deg, half_width=_HALF_WIDTH)
        if incident == "sun"
        else _SKIES[incident](half_width=_HALF_WIDTH)
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
    reflectances = 1.0 - np.array([transmitted(sea, i + 1) for i, sea in enumerate(seas)])
    return float(reflectances.mean()), float(error_of_groups(reflectances))


def sea_albedo(
    row: MeasuredRow, photons: float, wind_speed: float, direct_share: float, sky: str,
    water_light: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the albedo, p A_sun + (1 - p) A_sky + A_w, with p = 0 under an overcast sky."""
    each = max(int(_OF_SEA * photons), 1024)
    diffuse, diffuse_error = reflected(sky, 0.0, wind_speed, each)
    # below clouds no sun is seen
    p = direct_share if row.series == "clear" else 0.0
    sun, error = reflected("sun", row.at, wind_speed, each) if p else (0.0, 0.0)
    albedo = p * sun + (1.0 - p) * diffuse + water_light
    return albedo, float(np.hypot(p * error, (1.0 - p) * diffuse_error))
