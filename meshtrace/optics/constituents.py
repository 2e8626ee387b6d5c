"""Sea water with chlorophyll and its particles, dissolved organic matter and minerals."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from meshtrace.checks import Number, check_call
from meshtrace.errors import Described, Refused, require_array, require_between, require_range
from meshtrace.models import Floats
from meshtrace.optics import pure_water
from meshtrace.optics.phase import FournierForand, MixturePhase, PhaseFunction, Rayleigh
from meshtrace.optics.spectra import WaterSpectrum, uniform_or_layers

_MINERAL_RATIO = 0.0183
_DISSOLVED = 0.0524 * np.exp(-0.018 * (440.0 - 412.0))  # a_g at C = 1 [m-1]

Profile = float | tuple[tuple[float, float], ...]
"""A number, or rows (depth [m], number) from depth 0 downwards."""


class Constituents(WaterSpectrum, frozen=True):
    r"""Spectrum of sea water with chlorophyll, coloured dissolved matter and minerals.

    .. math::
        a &= a_w + A \, C^E + a_g e^{-S (\lambda - 440)} + 0.041 \, M e^{-0.0123 (\lambda - 443)} \\
        b &= b_w + 0.416 \, C^{0.766} (\lambda / 550)^v + 0.5 \, M \\
        \frac{b_{bp}}{b_p} &= 0.002 + 0.01 (0.5 - 0.25 \log_{10} C) (\lambda / 550)^v, \quad
        v = \tfrac{1}{2} (\log_{10} C - 0.3)

    with wavelengths in nm, v between -1 and 0, and by default
    a_g = 0.0524 C^0.63 exp(-0.018 (440 - 412)).

    Parameters
    ----------
    chlorophyll : float or rows (depth, chlorophyll)
        Chlorophyll concentration C [mg m-3], 0 ... 25; rows with depths [m] from 0 for layers.
    bbp700 : float or rows (depth, bbp700), or None
        Backscattering coefficient of the particles at 700 nm [m-1], which gives their scattering
        in place of chlorophyll.
    cdom : float or None
        Absorption of dissolved matter a_g at 440 nm [m-1], 0 ... 20; None for the mean of oceans
        with this chlorophyll.
    cdom_slope : float
        Its spectral slope S [nm-1], 0.005 ... 0.03.
    minerals : float
        Concentration M of mineral particles [g m-3], 0 ... 100.
    temperature_c : float
        Temperature [degree Celsius], 0 ... 30.
    salinity : float
        Salinity [g/kg], 0 ... 40.

    Raises
    ------
    Refused
        If a value lies outside its range; in `properties`, if the wavelength lies outside
        400 ... 700 nm.

    Notes
    -----
    Chlorophyll alone is Case-1 water, as the "new Case 1" of HydroLight: A and E of all particles
    by Bricaud and others (1998), here without ultraviolet; scattering of Loisel and Morel (1998)
    with the exponent and the backscatter ratio of Morel and Maritorena (2001, eqs. 12 to 14).
    Dissolved matter by Morel and Gentili (2009, eqs. 2 and 4a, as programmed in the water-leaving
    supplement of VLIDORT), from ocean colour at 412 and 443 nm. HydroLight has a fifth of the
    absorption by particles in its place, with which K_d at 440 nm is up to 26 % below the
    regression of Morel and Maritorena for C >= 1. All are means over oceans: single waters differ
    by a factor of 2.
    Minerals are coastal particles: b of Babin and others (2003a), who found little spectral
    variation; absorption of Babin and others (2003b); backscatter ratio 0.0183 of Petzold's average
    particle. Absorption a_w by `pure_water_absorption`, b_w by `zhang_hu_he`, n by `quan_fry`,
    which was fitted up to a salinity of 35.

    The phase function is the mean, weighted by b, of that of water molecules and of one of
    Fournier and Forand for each kind of particles (`fournier_forand_of`); with layers, that of the
    first.

    References
    ----------
    Bricaud, Morel, Babin, Allali and Claustre 1998, J. Geophys. Res. 103:31033,
    doi:10.1029/98JC02712; Loisel and Morel 1998, Limnol. Oceanogr. 43:847; Morel and Maritorena
    2001, J. Geophys. Res. 106:7163, doi:10.1029/2000JC000319; Morel and Gentili 2009, Remote Sens.
    Environ. 113:998, doi:10.1016/j.rse.2009.01.008; Babin, Morel, Fournier-Sicre, Fell
    and Stramski 2003, Limnol. Oceanogr. 48:843; Babin and others 2003, J. Geophys. Res. 108:3211,
    doi:10.1029/2001JC000882; Mobley, Ocean Optics Web Book, "A new IOP model for Case 1 water".

    Examples
    --------
    >>> found = Constituents(chlorophyll=0.5).properties(470.0)
    >>> round(found["a"], 4), round(found["b"], 4), round(found["n"], 4)
    (0.0497, 0.2598, 1.3446)
    """

    kind: Literal["constituents"] = "constituents"
    chlorophyll: Profile = 0.0
    bbp700: Profile | None = None
    cdom: float | None = Field(default=None, ge=0.0, le=20.0, allow_inf_nan=False)
    cdom_slope: float = Field(default=0.018, ge=0.005, le=0.03, allow_inf_nan=False)
    minerals: float = Field(default=0.0, ge=0.0, le=100.0, allow_inf_nan=False)
    temperature_c: float = Field(default=20.0, ge=0.0, le=30.0, allow_inf_nan=False)
    salinity: float = Field(default=35.0, ge=0.0, le=40.0, allow_inf_nan=False)

    @field_validator("chlorophyll", "bbp700", mode="before")
    @classmethod
    def _rows(cls, value: Any, info: ValidationInfo) -> Any:
        most = 25.0 if info.field_name == "chlorophyll" else 1.0
        if value is None or np.ndim(value) == 0:
            limits = f"0 to {most:g}, or rows of [depth, number]"
            return value if value is None else require_between(value, 0.0, most, "", "[]", limits)
        allowed = "a number, or rows of [depth, number] with depths increasing from 0 m"
        profile = require_array(value, "", allowed)
        if profile.ndim != 2 or profile.shape[1] != 2 or not np.isfinite(profile).all():
            raise Refused("", value, allowed)
        if profile[0, 0] != 0.0 or np.any(np.diff(profile[:, 0]) <= 0.0):
            raise Refused("", Described(f"depths {profile[:, 0]}"), allowed)
        require_range(profile[:, 1], 0.0, most, "", allowed=f"0 to {most:g}")
        return tuple(map(tuple, profile.tolist()))

    @property
    def source(self) -> str:
        """Constituents, and the publications of the coefficients."""
        parts = [f"sea water at {self.temperature_c:g} C, {self.salinity:g} g/kg"]
        for name, value, unit in (
            ("chlorophyll", self.chlorophyll, "mg m-3"),
            ("bbp700", self.bbp700, "m-1"),
            ("CDOM", self.cdom, "m-1 at 440 nm"),
            ("minerals", self.minerals, "g m-3"),
        ):
            if isinstance(value, tuple):
                parts.append(f"{name} at {len(value)} depths")
            elif value:
                parts.append(f"{name} {value:g} {unit}")
        known = ["Zhang 2009, Pope and Fry 1997"]
        if self.chlorophyll or self.bbp700:
            known.append("Morel and Maritorena 2001, Bricaud 1998")
        if self.chlorophyll and self.cdom is None:
            known.append("Morel and Gentili 2009")
        known += ["Babin 2003"] if self.minerals else []
        return f"{', '.join(parts)} ({', '.join(known)})"

    @property
    def limits_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength, of the index and of absorption by particles [nm]."""
        return 400.0, 700.0

    def properties(self, wavelength_nm: Number) -> dict[str, Any]:
        """Return n, the phase function, and a and b [m-1] or their layers.

        Parameters
        ----------
        wavelength_nm : float
            Wavelength in vacuum [nm], 400 ... 700.
        """
        w = pure_water.check_range("wavelength_nm", wavelength_nm, *self.limits_nm, "nm")
        depth, chlorophyll, bbp = self._nodes()
        t, s = np.asarray(self.temperature_c), np.asarray(self.salinity)
        molecules, v = float(pure_water.zhang_hu_he(w, t, s)), _exponent(chlorophyll)
        if bbp is None:
            # Loisel and Morel (1998), with the exponent of Morel and Maritorena (2001)
            particles = 0.416 * chlorophyll**0.766 * (w / 550.0) ** v
        else:
            # backscattering over its share is scattering, at the wavelength of the instrument
            particles = bbp / _backscatter_ratio(chlorophyll, 700.0) * (w / 700.0) ** v
        # Morel and Gentili (2009), carried from 412 nm, where they fitted it, to 440 nm
        cdom = _DISSOLVED * chlorophyll**0.63 if self.cdom is None else self.cdom
        nodes, *laws = pure_water.read_table("particle_absorption.csv").T
        factor, power = (pure_water.interpolate(w, nodes, law) for law in laws)
        a = pure_water.pure_water_absorption(w) + factor * chlorophyll**power
        a = a + cdom * np.exp(-self.cdom_slope * (w - 440.0))
        # Babin and others (2003b); scattering below by Babin and others (2003a)
        a = a + 0.041 * self.minerals * np.exp(-0.0123 * (w - 443.0))
        b = molecules + particles + 0.5 * self.minerals
        ratio = float(_backscatter_ratio(chlorophyll[0], float(w)))
        by_ratio = {ratio: float(particles[0]), _MINERAL_RATIO: 0.5 * self.minerals}
        return uniform_or_layers(depth, a, b) | {
            "n": float(pure_water.sea_water_index(w, t, s)),
            "phase": _mixture(molecules, by_ratio),
        }

    def _nodes(self) -> tuple[Floats, Floats, Floats | None]:
        """Return the depths of the profiles, with chlorophyll and bbp700 at them."""
        profiles = (self.chlorophyll, 0.0 if self.bbp700 is None else self.bbp700)
        tables = [np.array(p if isinstance(p, tuple) else [(0.0, p)]) for p in profiles]
        depth = np.unique(np.concatenate([row[:, 0] for row in tables]))
        chlorophyll, bbp = (np.interp(depth, *row.T) for row in tables)
        return depth, chlorophyll, None if self.bbp700 is None else bbp


def _exponent(chlorophyll: Floats) -> Floats:
    """Return v, the spectral exponent of scattering by particles (eq. 14): 0 above 2 mg m-3."""
    # at 0.02 mg m-3 the exponent is at its limit of -1
    v = 0.5 * (np.log10(np.maximum(chlorophyll, 0.02)) - 0.3)
    return np.where(np.asarray(chlorophyll) < 2.0, v, 0.0)


def _backscatter_ratio(chlorophyll: Floats, wavelength_nm: float) -> Floats:
    """Return the backscatter ratio b_b / b of the particles."""
    c = np.maximum(chlorophyll, 0.02)
    return 0.002 + 0.01 * (0.5 - 0.25 * np.log10(c)) * (wavelength_nm / 550.0) ** _exponent(c)


def _mixture(molecules: float, particles: dict[float, float]) -> PhaseFunction:
    """Return the phase function of water with particles, given as {backscatter ratio: b [m-1]}."""
    shares = {ratio: b for ratio, b in particles.items() if b > 0.0}
    water = Rayleigh(gamma=(1.0 - pure_water.DEPOLARISATION) / (1.0 + pure_water.DEPOLARISATION))
    if not shares:
        return water
    phases = (water, *(fournier_forand_of(ratio) for ratio in shares))
    return MixturePhase(components=phases, weights=(molecules, *shares.values()))


@check_call
@lru_cache(maxsize=1024)
def fournier_forand_of(
    backscatter_ratio: Annotated[float, Field(ge=1e-3, le=0.1)],
) -> FournierForand:
    r"""Return the Fournier-Forand phase function with a given backscatter ratio.

    .. math:: n = 1.01 + 0.1542 (\mu - 3)

    Parameters
    ----------
    backscatter_ratio : float
        Share of light that is scattered by more than 90 degrees, 0.001 ... 0.1.

    Returns
    -------
    FournierForand
        With n and mu to 6 digits after the point.

    Raises
    ------
    Refused
        If the ratio is out of range.

    References
    ----------
    Mobley, Sundman and Boss 2002, Appl. Opt. 41:1035, doi:10.1364/AO.41.001035; Mobley, Ocean
    Optics Web Book, "The Fournier-Forand phase function", table 1.

    Examples
    --------
    >>> fournier_forand_of(0.0183)
    FournierForand(n=1.099963, mu=3.583417)
    """
    from scipy.optimize import brentq

    def phase_of(mu: float) -> FournierForand:
        # rounded inside the search, so that the root is that of the function returned
        return FournierForand(n=round(1.01 + 0.1542 * (mu - 3.0), 6), mu=round(mu, 6))

    mu = brentq(
        lambda mu: phase_of(mu).backscatter_fraction - backscatter_ratio, 3.15, 4.2, xtol=1e-7
    )
    return phase_of(mu)
