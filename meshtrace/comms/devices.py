"""Receiver hardware: SiPM, amplifier, concentrating optics, and the LED at the other end."""

from __future__ import annotations

import math
from typing import Annotated, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import check_call
from meshtrace.comms.spectra import Curve, Share
from meshtrace.errors import Described, Refused
from meshtrace.models import Floats, Model, NonNegative, Positive
from meshtrace.results.impulse import SPEED_OF_LIGHT

# exact: BIPM, "The International System of Units", 9th edition (2019), section 2.2
_PLANCK = 6.62607015e-34  # J s
_ELEMENTARY_CHARGE = 1.602176634e-19  # C
_BOLTZMANN = 1.380649e-23  # J/K


@check_call
def photon_energy(wavelength: Annotated[float, Field(ge=1e-7, le=1e-5)]) -> float:
    """Return the energy of a photon, E = h c / lambda.

    Parameters
    ----------
    wavelength : float
        Wavelength in vacuum [m].

    Returns
    -------
    float
        Energy [J].

    Raises
    ------
    Refused
        If the wavelength is not between 100 nm and 10 um.

    Examples
    --------
    >>> print(f"{photon_energy(470e-9):.9e}")
    4.226480547e-19
    """
    return _PLANCK * SPEED_OF_LIGHT / wavelength


class SiPM(Model, frozen=True):
    """Silicon photomultiplier with crosstalk, afterpulses, dark counts and dead time.

    Every primary avalanche starts a Poisson number of secondary ones of mean
    lam = -ln(1 - P_CT - P_AP), and so on (Borel branching). Poisson primaries of mean m then give
    generalized Poisson counts of mean m / (1 - lam) and variance m / (1 - lam)^3, that is an excess
    noise factor F = 1 / (1 - lam): the mean over the standard deviation is sqrt(m / F).

    Parameters
    ----------
    gain : float
        Charge per avalanche G [electrons].
    n_spads : int
        Number of cells N.
    area : float
        Active area [m2].
    pde : float or Curve
        Photon detection efficiency [1], with the fill factor in it: never multiply by both. A
        number holds at every wavelength; of a table a file of wavelength [nm] and efficiency.
    dark_count_rate : float
        Primary dark counts of the whole device [s-1].
    p_crosstalk, p_afterpulse : float
        Probabilities of crosstalk and afterpulse per avalanche [1].
    recovery_time : float
        Dead time of a cell [s]; 0 gives a detector without saturation.
    bandwidth : float
        -3 dB frequency of its first-order response [Hz].

    Notes
    -----
    Afterpulses are treated as prompt, which is conservative. The defaults are those of the onsemi
    MicroFJ-30020 in the table of the paper (docs/paper.md), whose NEP of 3.42e-15 W Hz^-1/2 needs a
    PDE of 40 % where its table says 30 %. The recovery time is not in the paper.

    References
    ----------
    Vinogradov (2012), Nucl. Instrum. Methods A 695, 247, arXiv:1109.2014.
    """

    gain: Positive = 1e6
    n_spads: int = pydantic.Field(default=14410, gt=0)
    area: Positive = 9.43e-6
    pde: Share = 0.30
    dark_count_rate: NonNegative = 471e3
    p_crosstalk: float = pydantic.Field(default=0.025, ge=0.0, lt=0.5, allow_inf_nan=False)
    p_afterpulse: float = pydantic.Field(default=0.0075, ge=0.0, lt=0.1, allow_inf_nan=False)
    recovery_time: NonNegative = 15e-9
    bandwidth: Positive = 2e6

    def pde_at(self, wavelength_nm: ArrayLike) -> Floats:
        """Return the photon detection efficiency at wavelengths [nm]; 0 beyond a table."""
        if isinstance(self.pde, Curve):
            return self.pde.at(wavelength_nm)
        return np.full(np.shape(wavelength_nm), self.pde)

    def _pde(self, wavelength: float) -> float:
        """Return the detection efficiency at a wavelength [m]; refuse one at which it is 0."""
        if not isinstance(self.pde, Curve):
            return self.pde
        efficiency = float(self.pde.at(1e9 * wavelength))
        if efficiency == 0.0:
            low, high = self.pde.wavelength_nm[0], self.pde.wavelength_nm[-1]
            allowed = f"a table with an efficiency > 0 there, this one has {low:g} ... {high:g} nm"
            raise Refused("pde", Described(f"no efficiency at {1e9 * wavelength:g} nm"), allowed)
        return efficiency

    @property
    def branching(self) -> float:
        """Mean number of direct secondaries per avalanche, lam = -ln(1 - P_CT - P_AP)."""
        return -math.log1p(-(self.p_crosstalk + self.p_afterpulse))

    @property
    def excess_noise_factor(self) -> float:
        """F = 1 / (1 + ln(1 - P_CT - P_AP)); also the mean number of avalanches per primary."""
        return 1.0 / (1.0 - self.branching)

    @property
    def electrons_per_count(self) -> float:
        """Mean charge of a primary count with its secondaries, G F [electrons]."""
        return self.gain * self.excess_noise_factor

    @property
    def time_constant(self) -> float:
        """Time constant of the first-order response [s]."""
        return 1.0 / (2.0 * math.pi * self.bandwidth)

    def count_rate(self, power: ArrayLike, wavelength: float) -> Floats:
        """Return the primary counts of light before saturation, PDE P / E_ph [s-1].

        Parameters
        ----------
        power : array_like
            Optical power on the device [W], any shape.
        wavelength : float
            Wavelength [m].
        """
        return self._pde(wavelength) * np.asarray(power, dtype=float) / photon_energy(wavelength)

    def saturated_rate(self, rate: ArrayLike) -> Floats:
        """Return the primary counts that cells with a dead time register [s-1].

        r / (1 + r tau / N),  tau the recovery time, N the number of cells

        Parameters
        ----------
        rate : array_like
            Primary counts, dark ones included [s-1], any shape.

        Notes
        -----
        Each cell has a non-paralysable dead time, and the light is spread evenly over the cells.
        """
        r = np.asarray(rate, dtype=float)
        return r / (1.0 + r * self.recovery_time / self.n_spads)

    def fano_factor(self, rate: ArrayLike) -> Floats:
        """Return the Fano factor of the counts that saturated cells register: variance over mean.

        1 / (1 + x)^2,  x = r tau / N as in `saturated_rate`

        Parameters
        ----------
        rate : array_like
            Primary counts, dark ones included [s-1], any shape.

        Notes
        -----
        The intervals between the counts of a cell are its dead time plus an exponential time, of
        mean tau + N / r and standard deviation N / r. Over times much longer than these the
        variance of a renewal process over its mean is their squared ratio (Cox).

        References
        ----------
        Cox (1962), Renewal Theory, Methuen.
        """
        r = np.asarray(rate, dtype=float)
        return 1.0 / (1.0 + r * self.recovery_time / self.n_spads) ** 2

    def fired_cells(self, photons: ArrayLike, wavelength: float = 470e-9) -> Floats:
        """Return the mean number of cells fired by a flash shorter than the dead time.

        N_fired = N (1 - exp(-PDE n_ph / N))

        Parameters
        ----------
        photons : array_like
            Photons on the device n_ph, any shape.
        wavelength : float
            Wavelength [m], which matters for an efficiency from a table only; by default that of
            `LedDriver`.
        """
        n = self.n_spads
        return -n * np.expm1(-self._pde(wavelength) * np.asarray(photons, dtype=float) / n)

    def bias_current(self, rate: ArrayLike) -> Floats:
        """Return the mean current [A] of primary counts [s-1], G e F times their saturated rate."""
        return _ELEMENTARY_CHARGE * self.electrons_per_count * self.saturated_rate(rate)

    def nep_paper(self, wavelength: float) -> float:
        """Return the noise-equivalent power as the paper prints it.

        NEP = (E_ph F sqrt(f_c) / PDE) (1 + sqrt(1 + 2 DCR / f_c))

        Parameters
        ----------
        wavelength : float
            Wavelength [m].

        Returns
        -------
        float
            NEP [W Hz-1/2].

        Notes
        -----
        Paper, eq. NEP. It omits the F inside the root (+0.29 %). As it is limited by the signal's
        shot noise, it depends on the bandwidth, and `noise_power_paper` mixes the bandwidths f_c
        and R_b / 2. The consistent form is `p_min`.

        Examples
        --------
        >>> print(f"{SiPM(pde=0.4).nep_paper(470e-9):.6e}")
        3.419612e-15
        """
        root = 1.0 + math.sqrt(1.0 + 2.0 * self.dark_count_rate / self.bandwidth)
        scale = self.excess_noise_factor * math.sqrt(self.bandwidth) / self._pde(wavelength)
        return photon_energy(wavelength) * scale * root

    def noise_power_paper(self, wavelength: float, noise_bandwidth: NonNegative) -> float:
        """Return the equivalent optical noise power of the paper, P_n = NEP sqrt(B) [W].

        Parameters
        ----------
        wavelength : float
            Wavelength [m].
        noise_bandwidth : float
            B [Hz]; the paper takes R_b / 2.

        Notes
        -----
        The paper's "electrical SNR of 28.64 dB" is 10 log10(P_rx / P_n): a ratio of optical powers.
        """
        return self.nep_paper(wavelength) * math.sqrt(noise_bandwidth)

    def p_min(self, wavelength: float, noise_bandwidth: Positive) -> float:
        """Return the optical power whose SNR is 1 in a bandwidth B.

        P_min = (E_ph F B / PDE) (1 + sqrt(1 + 2 DCR / (F B))),
        from r / sqrt(2 B F (r + DCR)) = 1 with the count rate r = PDE P_min / E_ph

        Parameters
        ----------
        wavelength : float
            Wavelength [m].
        noise_bandwidth : float
            B [Hz], for instance R_b / 2.

        Returns
        -------
        float
            Power [W].

        Raises
        ------
        Refused
            If the bandwidth is not positive.
        """
        # the positive root of r^2 = 2 F B (r + DCR)
        fb = self.excess_noise_factor * noise_bandwidth
        root = 1.0 + math.sqrt(1.0 + 2.0 * self.dark_count_rate / fb)
        return photon_energy(wavelength) * fb / self._pde(wavelength) * root


class Tia(Model, frozen=True):
    """Transimpedance amplifier behind the SiPM.

    Parameters
    ----------
    resistance : float
        Feedback resistance R [ohm].
    temperature : float
        Temperature T [K].

    Notes
    -----
    The paper calls its 1 kohm a load. A passive 1 kohm load on the device's 1 nF or so would have
    a bandwidth of 0.15 MHz and not the 2 MHz it states, so it is read as a feedback resistance.
    """

    resistance: Positive = 1e3
    temperature: Positive = 300.0

    def thermal_noise(self, electrons: Positive) -> float:
        """Return the density of the thermal noise in count units [s-2 Hz-1].

        S = (4 k T / R) / (q e)^2, one-sided (Johnson noise of the current, in counts of charge q e)

        Parameters
        ----------
        electrons : float
            Charge per count q [electrons], see `SiPM.electrons_per_count`.
        """
        current = 4.0 * _BOLTZMANN * self.temperature / self.resistance  # density [A2 Hz-1]
        return current / (electrons * _ELEMENTARY_CHARGE) ** 2


class LedDriver(Model, frozen=True):
    """On-off keyed LED.

    Parameters
    ----------
    power : float
        Emitted optical power [W], the average one unless `power_is_peak`.
    wavelength : float
        Wavelength in vacuum [m].
    width_nm : float
        Full width at half maximum of a Gaussian spectrum [nm]; 0 for a single wavelength.
    spectrum : Curve, optional
        Spectrum of any unit in place of the Gaussian one: a file of wavelength [nm] and power.
    bandwidth : float
        -3 dB frequency of its first-order response [Hz].
    extinction_ratio : float
        xi = P0 / P1 [1], 0 <= xi < 1.
    power_is_peak : bool
        Whether `power` is the power of a one.

    Notes
    -----
    The paper does not say whether its 100 mW is the average or the peak; as peak power the average
    is 2.6 dB lower at xi = 0.1.
    """

    power: Positive = 0.1
    wavelength: float = pydantic.Field(default=470e-9, ge=1e-7, le=1e-5, allow_inf_nan=False)
    width_nm: NonNegative = 0.0
    spectrum: Curve | None = None
    bandwidth: Positive = 10e6
    extinction_ratio: float = pydantic.Field(default=0.1, ge=0.0, lt=1.0, allow_inf_nan=False)
    power_is_peak: bool = False

    @pydantic.model_validator(mode="after")
    def _one_spectrum(self) -> Self:
        if self.spectrum is not None and self.width_nm > 0.0:
            raise Refused("width_nm", self.width_nm, "0 beside spectrum")
        return self

    @property
    def time_constant(self) -> float:
        """Time constant of the first-order response [s]."""
        return 1.0 / (2.0 * math.pi * self.bandwidth)

    def levels(self, value: ArrayLike) -> tuple[Floats, Floats]:
        """Return the levels of a zero and a one for a power or count rate in the sense of `power`.

        x1 = 2 x / (1 + xi), or x if `power_is_peak`;  x0 = xi x1

        Parameters
        ----------
        value : array_like
            Average (or peak) value, any shape and unit.

        Returns
        -------
        tuple of ndarray
            (x0, x1), same shape and unit.
        """
        x = np.asarray(value, dtype=float)
        # zeros and ones are equally likely: x = (x0 + x1) / 2 with x0 = xi x1
        high = x if self.power_is_peak else 2.0 * x / (1.0 + self.extinction_ratio)
        return self.extinction_ratio * high, high


class OpticalFrontEnd(Model, frozen=True):
    """Lens or concentrator, and filter, in front of the SiPM.

    The share of the light in the field of view that reaches the detector is at most
    eta = min(1, A_SiPM n^2 / (A_lens n_medium^2 sin^2(fov / 2))).

    Parameters
    ----------
    radius : float
        Radius of the entrance aperture [m].
    fov_deg : float
        Full field of view [deg].
    concentrator_index : float
        Refractive index n around the detector [1].
    medium_index : float
        Refractive index n_medium in front of the aperture [1]: 1 in air, some 1.34 under water.
    etendue_limited : bool
        Whether the concentration is limited by the conservation of etendue.
    filter_transmission : float or Curve
        Transmission of the optical filter [1]: that of a rectangular band, or over wavelength at
        normal incidence, a file of wavelength [nm] and transmission.
    filter_width_nm : float
        Optical width of a rectangular band [nm].
    filter_center_nm : float, optional
        Centre of a rectangular band at normal incidence [nm]; the signal's wavelength by default.
    filter_index : float, optional
        Effective index of an interference filter: its transmission shifts to the blue under slanted
        light, lambda(theta) = lambda_0 sqrt(1 - (sin(theta) / n_eff)^2); none by default.

    Notes
    -----
    This departs from the paper (docs/paper.md), which takes all light through a lens of 5 cm radius
    with 60 degrees of field of view onto 9.43 mm2. That needs a concentration of 833, and no optics
    can exceed n^2 / sin^2(fov / 2) = 9: the loss is 19.7 dB (optical). `etendue_limited=False`
    selects the paper's form.

    The filter covers the aperture, so that light meets it at its angle of arrival. Behind a
    concentrator it would meet the filter at wider angles.

    References
    ----------
    Winston, Minano and Benitez (2005), Nonimaging Optics, Academic Press, chapter 2.

    Examples
    --------
    >>> print(f"{OpticalFrontEnd().efficiency(SiPM().area):.6f}")
    0.010806
    """

    radius: Positive = 0.05
    fov_deg: float = pydantic.Field(default=60.0, gt=0.0, le=180.0, allow_inf_nan=False)
    concentrator_index: float = pydantic.Field(default=1.5, ge=1.0, le=4.0, allow_inf_nan=False)
    medium_index: float = pydantic.Field(default=1.0, ge=1.0, le=2.0, allow_inf_nan=False)
    etendue_limited: bool = True
    filter_transmission: Share = 1.0
    filter_width_nm: Positive = 10.0
    filter_center_nm: float | None = pydantic.Field(default=None, ge=100.0, le=1e4)
    filter_index: float | None = pydantic.Field(default=None, ge=1.0, le=4.0)

    @pydantic.model_validator(mode="after")
    def _one_filter(self) -> Self:
        if self.filter_center_nm is not None and isinstance(self.filter_transmission, Curve):
            allowed = "none beside a table of filter_transmission"
            raise Refused("filter_center_nm", self.filter_center_nm, allowed)
        return self

    @property
    def spectral(self) -> bool:
        """Whether the filter is anything but a band of constant transmission around the signal."""
        shaped = isinstance(self.filter_transmission, Curve) or self.filter_center_nm is not None
        return shaped or self.filter_index is not None

    @property
    def peak_transmission(self) -> float:
        """Largest transmission of the filter [1]."""
        transmission = self.filter_transmission
        return max(transmission.value) if isinstance(transmission, Curve) else transmission

    @property
    def equivalent_width_nm(self) -> float:
        """Integral of the transmission at normal incidence over its largest value [nm]."""
        transmission = self.filter_transmission
        if isinstance(transmission, Curve):
            return transmission.integral / self.peak_transmission
        return self.filter_width_nm

    def band(self, wavelength_nm: float) -> tuple[float, float]:
        """Return the edges of the filter at normal incidence [nm] for a signal's wavelength."""
        transmission = self.filter_transmission
        if isinstance(transmission, Curve):
            return transmission.wavelength_nm[0], transmission.wavelength_nm[-1]
        center = wavelength_nm if self.filter_center_nm is None else self.filter_center_nm
        half = 0.5 * self.filter_width_nm
        # a band wider than twice its centre must still have wavelengths > 0
        return max(center - half, 1e-3), center + half

    @property
    def _acceptance(self) -> float:
        """Area times projected solid angle of the field of view [m2 sr]."""
        # pi r^2 times pi sin^2(fov / 2)
        half_angle = math.radians(0.5 * self.fov_deg)
        return math.pi * math.pi * self.radius**2 * math.sin(half_angle) ** 2

    def concentration_efficiency(self, detector_area: float) -> float:
        """Return the share of the accepted light that can reach the detector.

        Parameters
        ----------
        detector_area : float
            Active area [m2].
        """
        if not self.etendue_limited:
            return 1.0
        index = self.concentrator_index / self.medium_index
        # The largest etendue that a detector accepts is that of a hemisphere in its medium
        # (Winston et al., chapter 2). Etendue is n^2 times area times projected solid angle.
        limit = math.pi * detector_area * index**2
        return min(1.0, limit / self._acceptance)

    def efficiency(self, detector_area: float) -> float:
        """Return the concentration efficiency times the largest transmission of the filter."""
        return self.concentration_efficiency(detector_area) * self.peak_transmission

    def background_power(self, radiance_per_nm: NonNegative, detector_area: float) -> float:
        """Return the power of background light on the detector.

        P_b = L dlambda T G,  with the width dlambda and the largest transmission T of the filter
        and the part G [m2 sr] of the etendue that reaches the detector

        Parameters
        ----------
        radiance_per_nm : float
            Spectral radiance of the scene L [W m-2 nm-1 sr-1]; that of the water under a full moon
            is of the order of 8.6e-8.
        detector_area : float
            Active area [m2].

        Returns
        -------
        float
            Power [W].

        Raises
        ------
        Refused
            If the radiance is negative or not finite.
        """
        etendue = self._acceptance * self.efficiency(detector_area)
        return radiance_per_nm * self.equivalent_width_nm * etendue
