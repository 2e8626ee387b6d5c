"""Slopes of the sea, and sunlight focused by waves: variation, flashes and wavelengths below it.

The coefficient of variation is a closed form (`fading.scintillation_of_spectrum` of a lamp at
infinity); the wavelengths come from refracted rays over a patch of the sea. Slopes are those of
Elfouhaily's spectrum.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import gamma, lognorm

from meshtrace.fading import scintillation_of_spectrum
from meshtrace.link import AirLed, Link, WaterReceiver
from meshtrace.models import Floats
from meshtrace.optics import Water
from meshtrace.surfaces import Jonswap, SpectralSea, resolved_sea
from meshtrace.surfaces.statistics import mean_square_slope
from meshtrace.surfaces.waves import angular_frequency

from .beams import phase_of
from .daylight import light_below
from .suite import MeasuredRow

_FAR = 1e6  # [m], height of the lamp that stands for the sun
_N = 1.34
_SUN_DEG = 0.2666  # angular radius


def lamp_over(depth: float, collector: float, lamp_deg: float = _SUN_DEG) -> Link:
    """Return the link from a zenith lamp at infinity to a level collector of a radius [m].

    The image of a lamp of the angular radius `lamp_deg` widens it to hypot(r, d alpha / n).
    """
    radius = math.hypot(collector, depth * math.radians(lamp_deg) / _N)
    return Link(
        water=Water(a=0.0, b=0.0, n=_N),
        transmitter=AirLed(height=_FAR),
        receiver=WaterReceiver(depth=depth, radius=radius, fov_deg=180.0),
    )


@cache
def scintillation(depth: float, wind_speed: float, collector: float, fetch: float) -> float:
    """Return the scintillation index of unscattered sunlight; a `fetch` of 0 is a developed sea."""
    sea = resolved_sea(wind_speed, fetch or None)
    return scintillation_of_spectrum(lamp_over(depth, collector), sea)


@cache
def tank_scintillation(
    wavelength: float, slope: float, depth: float, lamp_deg: float, collector: float
) -> float:
    """Return the scintillation index below tank waves of a given rms slope.

    They have a JONSWAP spectrum about a wavelength [m].
    """
    peak = float(angular_frequency(2.0 * math.pi / wavelength, None, True))
    cut = 3.0 * peak

    def tank(hs: float) -> SpectralSea:
        return SpectralSea(spectrum=Jonswap(hs=hs, tp=2.0 * math.pi / peak), mss="band")

    # slopes are linear in the height of the waves: one height gives the scale of all
    steep = math.sqrt(sum(tank(0.01).slope_spectrum(cut).along_and_across))
    link, sea = lamp_over(depth, collector, lamp_deg), tank(0.01 * slope / steep)
    return scintillation_of_spectrum(link, sea, cut, tilts=False)


def flash_time(
    row: MeasuredRow, photons: float, wavelength: float, slope: float, depth: float,
    lamp_deg: float, collector: float, law: str,
) -> float:  # fmt: skip
    """Return the share of time above `at` times the mean, by a law with closed-form variance."""
    si = tank_scintillation(wavelength, slope, depth, lamp_deg, collector)
    width = math.sqrt(math.log1p(si))
    laws = {
        "gamma": gamma(1.0 / si, scale=si),
        "lognormal": lognorm(width, scale=math.exp(-0.5 * width**2)),
    }
    return 100.0 * float(laws[law].sf(row.at))


def windiest(
    row: MeasuredRow, photons: float, depth: float, collector: float, fetch: float
) -> float:
    """Return the wind speed of the largest scintillation index (`peak_of`)."""
    winds = np.geomspace(1.0, 14.0, 14)
    index = np.array([scintillation(depth, float(u), collector, fetch) for u in winds])
    return peak_of(winds, index)


def peak_of(x: Floats, y: Floats) -> float:
    """Return the position of a maximum, by a parabola in ln x through the three highest points."""
    i, log = int(np.clip(y.argmax(), 1, len(x) - 2)), np.log(x)
    a, b, _ = np.polyfit(log[i - 1 : i + 2], y[i - 1 : i + 2], 2)
    top = -0.5 * b / a if a < 0.0 else math.inf
    return math.exp(top) if log[i - 1] <= top <= log[i + 1] else float(x[y.argmax()])


_DEPTHS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 18.0, 25.0)


@cache
def variation(
    wind_speed: float, fetch: float, collector: float, a: float, b: float, forward_deg: float,
    diffuse: float, photons: int,
) -> Floats:  # fmt: skip
    """Return CV of E_d at the depths: the CV of focused light times its share of E_d.

    Light that is scattered by less than `forward_deg` still counts as focused.
    """
    planes = light_below(a, b, "average", 30.0, (0.01, *_DEPTHS), photons)
    depth = np.array(_DEPTHS)
    # light that is scattered forwards by little stays in the pattern
    lost = a + b * (1.0 - float(phase_of("average").cdf(math.radians(forward_deg))))
    # cosine of the way in the water, by Snell's law, of a sun at 30 degrees
    slant = math.sqrt(1.0 - (0.5 / _N) ** 2)
    focused = (1.0 - diffuse) * np.exp(-lost * depth / slant) / (planes.e_d[1:] / planes.e_d[0])
    index = [scintillation(float(d), wind_speed, collector, fetch) for d in depth]
    return np.minimum(focused, 1.0) * np.sqrt(index)


def depth_law(
    row: MeasuredRow, photons: float, wind_speed: float, fetch: float, collector: float,
    a: float, b: float, forward_deg: float, diffuse: float,
) -> float:  # fmt: skip
    """Return the mean CV of 0.25 to 2 m over the CV of 25 m, or the depth of the "peak"."""
    shots = max(int(2**17 * photons), 2**13)
    cv = variation(wind_speed, fetch, collector, a, b, forward_deg, diffuse, shots)
    return {"ratio": float(cv[:5].mean() / cv[-1]), "peak": peak_of(np.array(_DEPTHS), cv)}[
        row.series
    ]


_CELLS, _STEP, _PATCHES = 1024, 0.05, 12  # step [m]


def patch_slopes(sea: SpectralSea, seed: int, cells: int, step: float) -> tuple[Floats, Floats]:
    """Return the slopes of a periodic patch (cells, cells) of a sea, x along the wind."""
    k1 = 2.0 * math.pi * np.fft.fftfreq(cells, step)
    kx, ky = np.meshgrid(k1, k1, indexing="ij")
    k, theta = np.hypot(kx, ky), np.arctan2(ky, kx)
    # the mean has no wave, but its logarithm is taken with all others
    k[0, 0] = k1[1]
    # the spreading changes slowly with k
    nodes, ring = np.geomspace(k.min(), k.max(), 512), np.linspace(-math.pi, math.pi, 181)
    omega = angular_frequency(nodes, None, True)
    wind_speed, omega_p = sea.spectrum.wind_speed, sea.spectrum.omega_p
    spread = sea.spreading.density(omega[:, None], ring, omega_p=omega_p, wind_speed=wind_speed)
    variances = sea.spectrum(omega) * np.gradient(omega, nodes) / nodes
    density = RegularGridInterpolator((np.log(nodes), ring), variances[:, None] * spread)
    psi = density((np.clip(np.log(k), *np.log(nodes[[0, -1]])), theta))
    psi[0, 0] = 0.0
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((2, cells, cells))
    wave = np.sqrt(psi) * k1[1] * (noise[0] + 1j * noise[1])
    made = np.fft.ifft2(1j * kx * wave) * cells**2, np.fft.ifft2(1j * ky * wave) * cells**2
    return made[0].real, made[1].real


@cache
def light_spectra(wind_speed: float, depths: tuple[float, ...], patches: int) -> Floats:
    """Return power spectra of E_d over patches (depths, patches, 2, cells / 2), along and across.

    Rays of a zenith sun land at x - (1 - 1 / n) d s, exactly refracted, in cells of the patch.
    """
    sea = resolved_sea(wind_speed)
    spectra = np.zeros((len(depths), patches, 2, _CELLS // 2))
    axis = np.arange(_CELLS) * _STEP
    x, y = np.meshgrid(axis, axis, indexing="ij")
    for i in range(patches):
        sx, sy = patch_slopes(sea, i, _CELLS, _STEP)
        steep = np.hypot(sx, sy)
        tilt = np.arctan(steep)
        # displacement over depth by the exact refraction, over the slope
        bent = np.tan(tilt - np.arcsin(np.sin(tilt) / _N)) / np.maximum(steep, 1e-12)
        for j, depth in enumerate(depths):
            cells = [np.floor((p - depth * bent * s) / _STEP).astype(int) % _CELLS
                     for p, s in ((x, sx), (y, sy))]  # fmt: skip
            power_on_cells = np.bincount(
                (cells[0] * _CELLS + cells[1]).ravel(), minlength=_CELLS**2
            )
            power = np.abs(np.fft.fft2(power_on_cells.reshape(_CELLS, _CELLS) - 1.0)) ** 2
            power -= power[_CELLS // 2 - 20 : _CELLS // 2 + 20].mean()  # shot noise of the rays
            for m in (0, 1):
                spectra[j, i, m] = power.sum(axis=1 - m)[: _CELLS // 2]
    return spectra


def dominant_wavelength(
    row: MeasuredRow, photons: float, wind_speed: float, heading: str, smoothing: float, peak: str
) -> tuple[float, float]:
    """Return the wavelength of the peak of the spectrum of E_d along a track at a depth `at` [m].

    The sensor averages over `smoothing` [m]. The peak is that of "k S", or of "S" within the band
    of focusing that the source prints, 1 to 20 m.
    """
    patches = max(int(_PATCHES * photons), 4)
    spectra = light_spectra(wind_speed, row.along, patches)
    power = spectra[row.along.index(row.at), :, ("along", "across").index(heading)]
    k = 2.0 * math.pi * np.arange(_CELLS // 2) / (_CELLS * _STEP)
    # the transfer function of a running mean over the width of the sensor
    power = power * np.sinc(k * smoothing / (2.0 * math.pi)) ** 2
    edges = np.geomspace(k[1], k[-1], 25)
    middle = np.sqrt(edges[1:] * edges[:-1])
    count = np.histogram(k, edges)[0]
    seen, rise = (count > 0) & (abs(np.log(middle / 1.405)) < 1.498), 1.0
    if peak == "k S":
        seen, rise = count > 0, middle

    def wavelength(spectrum: Floats) -> float:
        mean = np.histogram(k, edges, weights=spectrum)[0] / np.maximum(count, 1)
        return 2.0 * math.pi / peak_of(middle[seen], (mean * rise)[seen])

    # jackknife over patches
    left = np.array([wavelength(power.sum(axis=0) - sample) for sample in power])
    return wavelength(power.mean(axis=0)), math.sqrt((patches - 1.0) * left.var())


_ROUGHNESS = 1e-4  # [m], roughness length of a neutral wind over the sea, for its profile


@cache
def variances(wind_speed: float, fetch: float | None, shortest: float) -> tuple[float, float]:
    """Return the slope variances along and across the wind of waves longer than `shortest` [m]."""
    highest = float(angular_frequency(2.0 * math.pi / shortest, None, True))
    spectrum = resolved_sea(wind_speed, fetch).slope_spectrum(highest)
    return spectrum.along_and_across


def mean_square_slopes(
    row: MeasuredRow, photons: float, wind_height: float, fetch: float, shortest: float
) -> float:
    """Return slope variances of the series "up" and "cross", or their "ratio", at a wind.

    The wind at `wind_height` [m] is that of a neutral profile; a `fetch` of 0 is a developed sea.
    """
    # the logarithmic profile of a neutral wind
    u10 = row.at * math.log(10.0 / _ROUGHNESS) / math.log(wind_height / _ROUGHNESS)
    up, cross = variances(u10, fetch or None, shortest)
    return {"up": up, "cross": cross, "ratio": up / cross}[row.series]


def law_of_weak_winds(
    row: MeasuredRow, photons: float, fetch: float, shortest: float, lowest_wind: float
) -> float:
    """Return d ln(mss) / d ln(U) from `lowest_wind` to 7 m/s: nadir glint goes as 1 / mss."""
    winds = np.geomspace(lowest_wind, 7.0, 6)
    mss = [sum(variances(float(u), fetch or None, shortest)) for u in winds]
    return float(np.polyfit(np.log(winds), np.log(mss), 1)[0])


def beam_wander(
    row: MeasuredRow, photons: float, fetch: float, wind_speed: float, cut: float
) -> float:
    """Return the rms deviation (n - 1) / n s of a beam into the water, over that at half the wind.

    Small slopes of JONSWAP waves over the fetch of a tank, up to `cut` times the peak frequency.
    """
    seas = [Jonswap(wind_speed=u, fetch=fetch) for u in (wind_speed, 0.5 * wind_speed)]
    strong, weak = (mean_square_slope(s, cut * s.omega_p, capillary=True) for s in seas)
    return math.sqrt(strong / weak)
