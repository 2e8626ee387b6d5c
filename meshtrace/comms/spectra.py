"""Spectra of a link: source, filter and detector over wavelength, and integrals over them."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Annotated, Any, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike

from meshtrace.checks import check_call
from meshtrace.errors import (
    Described,
    Refused,
    refusing,
    require_array,
    require_between,
    require_keys,
    warn_of_input,
)
from meshtrace.models import Floats, Model, NonNegative, Positive
from meshtrace.tables import PLAUSIBLE_NM, Column, read_columns
from meshtrace.units import convert, cycles, is_convertible

_NODES = 2001  # wavelengths over the spectrum of a source or a band; tuned: error against time
_RAYS = 512  # angles of a filled field of view; tuned: error against time
_WIDTHS = 4.0  # where a Gaussian spectrum is cut on either side, in full widths at half maximum
_FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))  # of a Gaussian, in standard deviations


_COLUMNS = (
    Column(
        "wavelength",
        "nm",
        ("lambda", "wl", "wave", "wavelengths", "lambda_0", "wvl", "wlen"),
        plausible=PLAUSIBLE_NM,
    ),
    Column(
        "value",
        "1",
        ("power", "intensity", "pde", "transmission", "transmittance", "gain", "response",
         "spectrum", "responsivity", "qe", "eqe", "efficiency", "quantum efficiency"),
        relative=True,
    ),
)  # fmt: skip


class Curve(Model, frozen=True):
    """Values over wavelength, linear between them and 0 beyond.

    In link files also ``{file = "led.csv"}``: a text file of the columns wavelength [nm] and value,
    see `tables.read_columns`. Other units of the wavelength are converted, and per cent.

    Parameters
    ----------
    wavelength_nm : sequence of float
        Wavelengths [nm], rising, two or more.
    value : sequence of float
        Values >= 0, not all 0.

    Examples
    --------
    >>> round(float(Curve(wavelength_nm=(450.0, 470.0), value=(0.2, 0.4)).at(460.0)), 6)
    0.3
    """

    wavelength_nm: tuple[Positive, ...]
    value: tuple[NonNegative, ...]

    @pydantic.model_validator(mode="before")
    @classmethod
    def _from_file(cls, data: Any) -> Any:
        return _read_curve(data) if isinstance(data, dict) and "file" in data else data

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.wavelength_nm) < 2 or np.any(np.diff(self.wavelength_nm) <= 0.0):
            count = Described(f"{len(self.wavelength_nm)} wavelengths")
            raise Refused("wavelength_nm", count, "two or more, rising [nm]")
        if len(self.value) != len(self.wavelength_nm) or not any(self.value):
            count = Described(f"{len(self.value)} values")
            raise Refused("value", count, "a value >= 0 for each wavelength, not all 0")
        return self

    def at(self, wavelength_nm: ArrayLike) -> Floats:
        """Return the values at wavelengths [nm], any shape."""
        at = np.asarray(wavelength_nm, float)
        return np.interp(at, self.wavelength_nm, self.value, left=0.0, right=0.0)

    @property
    def integral(self) -> float:
        """Integral over wavelength [nm]."""
        return float(np.trapezoid(self.value, self.wavelength_nm))


def _read_curve(data: dict[str, Any], *, share: bool = False) -> dict[str, Any]:
    """Return the fields of a `Curve` from a file.

    With `share` the values are shares, in per cent or without unit. Other values may have any unit,
    as their scale does not matter, but not one of a density over frequency.
    """
    require_keys(data, ["file"])
    path = data["file"]
    if not isinstance(path, str):
        raise Refused("file", path, "the path of a text file")
    table = read_columns(path, _COLUMNS)
    nm, (value, heading) = table["wavelength"], table["value"]
    unit = heading.unit if heading else None
    if unit and (share or is_convertible(unit, "1")):
        scaled = convert(value, unit, "1", f"{path}: column {heading.text if heading else 2}")
        if not np.array_equal(scaled, value):
            warn_of_input(f"{path}: value in {unit} converted to shares")
        value = scaled
    elif cycles(unit):  # W/Hz, for instance
        raise Refused(path, Described(f"values in {unit}"), "values over wavelength")
    return {"wavelength_nm": nm.values.tolist(), "value": value.tolist()}


def _share_or_curve(value: Any, _: Any, info: pydantic.ValidationInfo) -> float | Curve:
    """Return a share 0 < x <= 1, or shares over wavelength; refuse other values by name."""
    if isinstance(value, dict | Curve):
        if isinstance(value, dict) and "file" in value:
            value = _read_curve(value, share=True)
        curve = Curve.model_validate(value)
        if max(curve.value) > 1.0:
            raise Refused("value", max(curve.value), "shares 0 ... 1")
        return curve
    name = str(info.field_name)
    allowed = f"0 < {name} <= 1, or a table of wavelength_nm and value, or of file"
    return require_between(value, 0.0, 1.0, name, "(]", allowed)


def _ook(value: Any) -> Any:
    """Return an `OokLink`; refuse other objects."""
    # by its attribute: `ook` imports this module, so that its class cannot be imported here
    if not hasattr(value, "optics"):
        raise Refused("", Described(type(value).__name__), "an OokLink")
    return value


Transmission = Annotated[Any, pydantic.AfterValidator(_ook)]  # an `OokLink`

Share = Annotated[float | Curve, pydantic.WrapValidator(_share_or_curve)]
"""A share, or shares over wavelength."""


def _view(fov_deg: float) -> Floats:
    """Return sin^2 of angles of incidence (n,) that share the light of a uniform scene equally."""
    # projected solid angle, and with it the light of a uniform scene, is proportional to sin^2
    edge = math.sin(math.radians(0.5 * fov_deg)) ** 2
    return edge * (np.arange(_RAYS) + 0.5) / _RAYS


def _factors(sin2: Floats, index: float | None) -> Floats:
    """Return the factors f(theta) on the wavelengths of a filter, see `signal_passed`."""
    return np.ones(1) if index is None else np.sqrt(1.0 - sin2 / index**2)


@check_call
@functools.lru_cache(maxsize=256)
def signal_passed(ook: Transmission) -> tuple[float, float]:
    r"""Return the share of the LED's light that passes the filter, and its counts per photon.

    The counts are those over the photons in front of the filter, as if all had the signal's
    wavelength.

    .. math:: S = \int s(\lambda) \, g(\lambda) \,
        \langle T(\lambda / f(\theta)) \rangle \, d\lambda, \quad
        f(\theta) = \sqrt{1 - (\sin\theta / n_\mathrm{eff})^2}

    with the spectrum s of unit area, the gain of the channel g over that at the signal's
    wavelength, and the mean over the angles of arrival. For the counts the integrand has the
    further factor PDE(lambda) lambda / lambda_signal.
    """
    signal_nm = 1e9 * ook.led.wavelength
    at, weight = _source(ook, signal_nm)
    gain = ook.gain_spectrum
    if gain is None and ook.response is not None:
        gain = ook.response.gain_spectrum
    if gain is not None:
        signal_gain = float(gain.at(signal_nm))
        if signal_gain == 0.0:
            low, *_, high = gain.wavelength_nm
            raise Refused("gain_spectrum", signal_nm, f"light at the signal, {low:g} ... {high:g}")
        weight = weight * gain.at(at) / signal_gain
    sin2 = _view(ook.optics.fov_deg)
    if ook.response is not None and ook.response.angle_deg:
        sin2 = np.sin(np.radians(ook.response.angle_deg)) ** 2
    # a joule has photons in proportion to the wavelength
    counts = weight * ook.sipm.pde_at(at) * at / signal_nm
    share, counted = (_through(ook.optics, signal_nm, at, w, sin2) for w in (weight, counts))
    return share, counted


def lit_band(ook: Transmission) -> tuple[float, float]:
    """Return the limits of the LED's wavelengths that can pass the filter [nm].

    Both are the signal's wavelength for an LED of a single wavelength. The light of a Gaussian
    spectrum more than two full widths at half maximum from its centre, 3e-6 of all, is left out.
    """
    led, signal_nm = ook.led, 1e9 * ook.led.wavelength
    low, high = signal_nm - 2.0 * led.width_nm, signal_nm + 2.0 * led.width_nm
    if led.spectrum is not None:
        low, *_, high = led.spectrum.wavelength_nm
    first, last = ook.optics.band(signal_nm)
    # light at oblique incidence passes at shorter wavelengths
    first *= float(_factors(_view(ook.optics.fov_deg), ook.optics.filter_index).min())
    # a filter that misses the signal's wavelength is widened up to it
    return max(low, min(first, signal_nm)), min(high, max(last, signal_nm))


@check_call
def background_counted(
    ook: Transmission, nm: Positive, irradiance: Callable[[Floats], Floats]
) -> float:
    r"""Return the counts of background light behind the filter as an equivalent width [nm].

    .. math:: \int \frac{L(\lambda)}{L(\lambda_0)} \langle T(\lambda / f(\theta)) \rangle
        \mathrm{PDE}(\lambda) \frac{\lambda}{\lambda_0} \, d\lambda

    Parameters
    ----------
    ook : OokLink
        Filter and detector; the light fills the field of view.
    nm : float
        Wavelength of the background :math:`\lambda_0` [nm].
    irradiance : callable
        Function of wavelengths (n,) [nm] that returns L over L at the background's wavelength.
    """
    optics = ook.optics
    sin2 = _view(optics.fov_deg)
    low, high = optics.band(1e9 * ook.led.wavelength)
    low *= float(_factors(sin2, optics.filter_index).min())
    # the nodes reach beyond the edges of the band, so that the edges lie between nodes
    beyond = 0.01 * (high - low)
    at = np.linspace(max(low - beyond, 1e-3), high + beyond, _NODES)
    allowed = "a function of wavelengths (n,) [nm] that returns a number for each"
    with refusing("irradiance", allowed):
        spectrum = np.broadcast_to(require_array(irradiance(at), "irradiance", allowed), at.shape)
    weight = spectrum * ook.sipm.pde_at(at) * at / nm * (at[1] - at[0])
    return _through(optics, 1e9 * ook.led.wavelength, at, weight, sin2)


def _source(ook: Transmission, nm: float) -> tuple[Floats, Floats]:
    """Return wavelengths (n,) [nm] and the shares of the LED's light at them, of sum 1."""
    led = ook.led
    if led.spectrum is not None:
        at = np.linspace(led.spectrum.wavelength_nm[0], led.spectrum.wavelength_nm[-1], _NODES)
        density = led.spectrum.at(at)
    elif led.width_nm > 0.0:
        at = nm + led.width_nm * np.linspace(-_WIDTHS, _WIDTHS, _NODES)
        # a wide spectrum is cut at wavelength 0
        density = np.exp(-0.5 * ((at - nm) * _FWHM / led.width_nm) ** 2) * (at > 0.0)
    else:
        return np.array([nm]), np.ones(1)
    return at, density / density.sum()


def _through(optics: Any, signal_nm: float, at: Floats, weight: Floats, sin2: Floats) -> float:
    """Return the sum of weights (n,) that pass a filter, averaged over angles of incidence."""
    factors = _factors(sin2, optics.filter_index)[:, None]
    transmission = optics.filter_transmission
    if isinstance(transmission, Curve):
        # light at an angle theta meets the transmission of lambda / f(theta) at normal incidence
        return float((transmission.at(at / factors) @ weight).mean())
    low, high = optics.band(signal_nm)
    if len(at) == 1:
        passes = (low * factors <= at) & (at <= high * factors)
        return float(transmission * weight[0] * passes.mean())
    # The edges of the band fall between nodes. Each node stands for a cell of one step, and the
    # cumulative sum at the edges of the cells is interpolated to those of the band.
    step = at[1] - at[0]
    edges = np.append(at - 0.5 * step, at[-1] + 0.5 * step)
    sums = np.append(0.0, np.cumsum(weight))
    inside = np.interp(high * factors, edges, sums) - np.interp(low * factors, edges, sums)
    return float(transmission * inside.mean())
