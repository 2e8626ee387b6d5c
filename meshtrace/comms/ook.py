"""On-off keying received by a SiPM: from optical power on the device to bit errors.

`OokLink` joins the LED, the optics, the SiPM and the amplifier at one bit rate. `OokLink.ber` maps
optical power to the bit error rate under a receiver model (`meshtrace.comms.receivers`).
"""

from __future__ import annotations

import functools
import math
from typing import Annotated, Any, Literal, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace.checks import ErrorRate
from meshtrace.comms.decisions import ReceiverModel, non_negative, pattern_decision
from meshtrace.comms.devices import LedDriver, OpticalFrontEnd, SiPM, Tia, photon_energy
from meshtrace.comms.pulses import Eye, PulseFilters
from meshtrace.comms.response import SHORT, ChannelResponse
from meshtrace.comms.spectra import Curve, background_counted, signal_passed
from meshtrace.daylight.light import Daylight
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.link import Link, Receiver
from meshtrace.models import Floats, Model, NonNegative

Preset = Literal["physical", "paper", "paper-ranges"]

_BLOCK = 256  # powers decided at a time: bounds memory, as each has up to 2^memory patterns
_NEGLIGIBLE_CURSOR = 1e-9  # share of a bit in the sample [1] below which its bit is left out
_MOST_POWER = 1e9  # [W], far above any source: stands for unlimited power in searches


class OokLink(Model, frozen=True):
    """NRZ on-off keying from an LED to a SiPM with one fixed decision threshold.

    Parameters
    ----------
    bit_rate : float
        R_b [bit s-1].
    led : LedDriver
        Power, pole and extinction ratio of the LED.
    sipm : SiPM
        Detector.
    tia : Tia
        Amplifier.
    optics : OpticalFrontEnd
        Lens, field of view and filter.
    model : {"W", "A", "CP", "PC", "G0", "GP"} or ReceiverModel
        Receiver model, by its kind or as an object.

        * W: output averaged over a window that ends with the bit; Campbell shot noise; bit
          patterns. The default.
        * A: output sampled at the end of the bit (W with a window of 0).
        * CP: as W, with the exact compound Poisson law in place of the Gaussian one; slower.
        * PC: sampled mean, noise of the pattern's mean in B = min(R_b / 2, pi / 2 f_c).
        * G0: no intersymbol interference, Gaussian noise in B = R_b / 2.
        * GP: no intersymbol interference, exact generalized Poisson counts per bit.
        * Any subclass of `ReceiverModel`.
    background_rate : float
        Primary counts from background light [s-1].
    saturation : bool
        Whether the dead time of the cells compresses the levels.
    saturation_noise : {"auto", "renewal", "poisson"}
        Shot noise of saturated cells: "renewal" reduces it by the Fano factor of their dead time
        (`SiPM.fano_factor`), "poisson" keeps that of the compressed rate. "auto" is "renewal" with
        background light and a Gaussian model, otherwise "poisson".
    response : ChannelResponse, optional
        Response of the channel, which spreads the pulses of all models but G0 and GP; by default,
        and with an rms delay spread below a thousandth of a bit, it is instantaneous.
    gain_spectrum : Curve, optional
        Gain of the channel over wavelength, of any scale, which weighs the spectrum of the LED; by
        default that of the signal's wavelength holds at all.
    memory : int
        Bits of intersymbol interference, the present one included.
    window : float, optional
        Averaging window of models W and CP [s], up to one bit; None takes the best for the bit
        rate (least power at 1e-3, in steps of a twentieth of a bit).
    equalizer : {"none", "dfe"}
        "dfe" is the bound of decision feedback: the mean of earlier bits is removed, their shot
        noise stays.
    calibration : {"none", "paper-ranges"}
        Label of the empirical setting described in `status`; it changes no formula here.

    Notes
    -----
    The sample is taken at the end of the bit, which is the best instant for a causal low-pass
    filter; behind a channel it is later by the median delay of the response. The LED's pole and the
    channel shape the light, the receiver's filters alone the noise of the counts. In count units
    (charge over gain, secondaries divided out),

        mean = r0 + (r1 - r0) sum(b_k w_k)
        variance = F [r0 E + (r1 - r0) sum(b_k v_k)] + S E / 2,  E = int g^2

    with the bits b_k = 0 or 1, their shares w_k and v_k in the mean and in the shot noise and the
    impulse response g of the receiver from `PulseFilters`, the count rates r0 and r1 of long zeros
    and ones with dark and background counts, `SiPM.excess_noise_factor` F and `Tia.thermal_noise`
    S. All patterns share the one threshold that minimises the error rate.

    The error rates of the Gaussian model W and of the exact law CP, each with its own best
    threshold, agree within 8 % (0.1 dB in power) at 1e-2 and 1e-3 for 1, 5 and 10 Mbit/s. The
    Gaussian threshold however lies too low for the skewed counts: a receiver that uses it at 1 or
    5 Mbit/s and 1e-3 makes nearly twice as many errors (model A at 1 Mbit/s: nearly three times).
    Set a real threshold with CP. Where a one has about a count or less (error rates above 0.3) all
    Gaussian models are too optimistic: 0.35 in place of 0.40 at 10 Mbit/s.

    References
    ----------
    Ijeh, Khalighi et al. (2021), IEEE J. Ocean. Eng. (Gaussian model with optimal threshold).
    Consul and Jain (1973), Technometrics 15, 791 (generalized Poisson law).

    Examples
    --------
    >>> link = OokLink(bit_rate=1e6, model="GP", saturation=False)
    >>> print(f"{float(link.ber(2e-11)):.5e}")
    3.80476e-04
    """

    bit_rate: float = pydantic.Field(default=1e6, gt=0.0, le=1e10, allow_inf_nan=False)
    led: LedDriver = LedDriver()
    sipm: SiPM = SiPM()
    tia: Tia = Tia()
    optics: OpticalFrontEnd = OpticalFrontEnd()
    model: str | pydantic.SerializeAsAny[ReceiverModel] = "W"
    background_rate: NonNegative = 0.0
    saturation: bool = True
    saturation_noise: Literal["auto", "renewal", "poisson"] = "auto"
    response: ChannelResponse | None = None
    gain_spectrum: Curve | None = None
    memory: int = pydantic.Field(default=8, ge=1, le=12)
    window: float | None = pydantic.Field(default=None, ge=0.0, allow_inf_nan=False)
    equalizer: Literal["none", "dfe"] = "none"
    calibration: Literal["none", "paper-ranges"] = "none"

    @pydantic.field_validator("model", mode="before")
    @classmethod
    def _known_model(cls, model: Any) -> str | ReceiverModel:
        # a model with default fields is stored by its kind, so that plain data stay short
        receiver = ReceiverModel.read(model)
        kind = str(receiver.model_dump()["kind"])
        return receiver if receiver.model_dump(exclude_defaults=True) else kind

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        # 1 / R_b is rounded: a window of one bit may exceed it in the last binary digit
        if self.window is not None and self.window > self.bit_time * (1.0 + 1e-12):
            raise Refused("window", self.window, f"0 <= window <= {self.bit_time} s")
        if self.saturation_noise == "renewal" and self.receiver.exact_counts:
            allowed = "auto or poisson for models of exact counts (CP, GP)"
            raise Refused("saturation_noise", "renewal", allowed)
        return self

    @classmethod
    def preset(cls, name: Preset, **fields: Any) -> Self:
        """Return the physical receiver, the paper's receiver, or its empirical calibration.

        Parameters
        ----------
        name : {"physical", "paper", "paper-ranges"}
            "physical" is model W behind etendue-limited optics; "paper" model PC behind a loss-free
            lens; "paper-ranges" is "paper" with `calibration` set, see `status`.
        **fields
            Any other field of the class, such as `bit_rate`.

        Raises
        ------
        Refused
            If the name is unknown.
        """
        preset: dict[str, Any] = {}
        if name != "physical":
            preset = {"model": "PC", "optics": OpticalFrontEnd(etendue_limited=False)}
        if name == "paper-ranges":
            preset["calibration"] = name
        return cls.model_validate(preset | fields)

    @classmethod
    def of_link(
        cls, link: Link, base: OokLink | Preset = "physical", bit_rate: float | None = None,
        receiver: int | None = None,
    ) -> Self:  # fmt: skip
        """Return the on-off keyed transmission over a link.

        Parameters
        ----------
        link : Link
            Source of the power, wavelength, aperture radius, field of view, and of the refractive
            index of the medium in front of the aperture.
        base : OokLink or preset
            Everything else.
        bit_rate : float, optional
            R_b [bit s-1]; by default that of `base`.
        receiver : int, optional
            Index of the receiver; needed for a link of several.

        Raises
        ------
        Refused
            If the preset is unknown, the bit rate does not fit, the link has sources of several
            wavelengths, or several receivers and none is chosen.

        Examples
        --------
        >>> from meshtrace.link import Led
        >>> OokLink.of_link(Link(transmitter=Led(power_mw=50.0)), bit_rate=5e6).led.power
        0.05
        """
        if receiver is None and len(link.receivers) != 1:
            raise Refused("receiver", f"{len(link.receivers)} apertures", "one aperture")
        require_whole(receiver or 0, 0, len(link.receivers) - 1, "receiver")
        aperture: Any = link.receivers[receiver or 0]
        wavelengths = sorted({t.wavelength_nm for t in link.transmitters})
        if len(wavelengths) > 1:  # an efficiency and an energy of photons each: powers do not add
            values = Described(" and ".join(f"{nm:g} nm" for nm in wavelengths))
            raise Refused("transmitter.wavelength_nm", values, "one wavelength")
        base = base if isinstance(base, OokLink) else cls.preset(base)
        power = 1e-3 * sum(t.power_mw for t in link.transmitters)
        # a `Receiver` is in air, any other aperture in water
        index = link.n_air if isinstance(aperture, Receiver) else link.water.n
        changes = {
            "bit_rate": base.bit_rate if bit_rate is None else bit_rate,
            "led": base.led.replace(power=power, wavelength=wavelengths[0] / 1e9),
            "optics": base.optics.replace(
                radius=aperture.radius, fov_deg=aperture.fov_deg, medium_index=index
            ),
        }
        return cls.model_validate(dict(base) | changes)

    def channel(self, link: Link) -> Link:
        """Return a link with its absorption scaled by `absorption_factor`.

        Parameters
        ----------
        link : Link
            The link; returned unchanged unless `calibration` is "paper-ranges".
        """
        factor, water = self.absorption_factor, link.water
        if factor == 1.0:
            return link
        changes: dict[str, Any] = {"a": factor * water.a}
        if water.layers is not None:  # of depth [m], absorption and scattering [m-1]
            changes["layers"] = tuple((z, factor * a, b) for z, a, b in water.layers)
        return link.model_copy(update={"water": water.model_copy(update=changes)})

    @property
    def absorption_factor(self) -> float:
        """Factor on the water's absorption in the channel gain [1]."""
        # empirical, from the ranges that the paper prints: no cause is known, see `status`
        return 2.0 if self.calibration == "paper-ranges" else 1.0

    @property
    def status(self) -> str:
        """Statement on the calibration, shown with every result."""
        if self.calibration == "none":
            return "no empirical calibration"
        return (
            "empirical calibration 'paper-ranges': absorption counted twice (a -> 2a), loss-free "
            "aperture, receiver PC. It brings the flat-sea ranges near the printed ones; it is "
            "not derived from the paper's stated parameters and is not physics."
        )

    @property
    def bit_time(self) -> float:
        """T = 1 / R_b [s]."""
        return 1.0 / self.bit_rate

    @property
    def receiver(self) -> ReceiverModel:
        """Receiver model as an object."""
        return ReceiverModel.read(self.model)

    @property
    def averaging_window(self) -> float:
        """Window in use [s]: 0 unless the model averages, as W and CP do."""
        return self.receiver.averaging_window(self)

    @property
    def on_detector(self) -> OokLink:
        """Copy of the link reduced to what matters for a given power on the SiPM.

        The optics are the default ones, and a response that counts as instantaneous is dropped, so
        that links that differ in these alone share cached results. A spectral link stays as it is:
        its counts per power depend on the filter and the response.
        """
        if self.spectral:
            return self
        response = self.response if self.spread_in_bits >= SHORT else None
        return self.model_copy(update={"optics": OpticalFrontEnd(), "response": response})

    @property
    def filters(self) -> PulseFilters:
        """LED pole, response of the channel, SiPM pole and averaging window in use."""
        tau_led, tau_sipm = self.led.time_constant, self.sipm.time_constant
        response = self.response if self.spread_in_bits >= SHORT else None
        return PulseFilters(tau_led, tau_sipm, self.averaging_window, response)

    @property
    def spread_in_bits(self) -> float:
        """Rms delay spread of the channel over the bit time [1]."""
        return 0.0 if self.response is None else self.response.rms_spread * self.bit_rate

    def received_power(self, gain: ArrayLike) -> Floats:
        """Return the optical power on the SiPM [W] for a channel gain, in the sense of `led.power`.

        Parameters
        ----------
        gain : array_like
            Share of the emitted power that enters the aperture and field of view, any shape.
        """
        g = non_negative("gain", gain)
        concentrated = self.optics.concentration_efficiency(self.sipm.area)
        return self.led.power * (concentrated * self.filter_share) * g

    @property
    def spectral(self) -> bool:
        """Whether power and counts are integrals over wavelength instead of plain products."""
        led = self.led
        return led.width_nm > 0.0 or led.spectrum is not None or self.optics.spectral

    @property
    def filter_share(self) -> float:
        """Share of the signal that passes the filter [1], see `spectra.signal_passed`."""
        return signal_passed(self)[0] if self.spectral else self.optics.peak_transmission

    def count_rate(self, power: ArrayLike) -> Floats:
        """Return the primary counts of the signal per second, before saturation [s-1].

        Parameters
        ----------
        power : array_like
            Optical power on the SiPM [W], any shape.
        """
        if not self.spectral:
            return self.sipm.count_rate(power, self.led.wavelength)
        share, counted = signal_passed(self)
        # `power` is already behind the filter, so that its share must not count twice
        efficiency = counted / share if share > 0.0 else 0.0
        power = np.asarray(power, dtype=float)
        return efficiency * power / photon_energy(self.led.wavelength)

    def background_count_rate(self, background: Any) -> float:
        """Return the primary counts of a background [s-1], see `results.Background.count_rate`."""
        # by its attribute: `Background` is defined above this package, which must not import it
        if not hasattr(background, "radiance"):
            raise Refused("background", Described(type(background).__name__), "a Background")
        optics, background_nm = self.optics, background.wavelength_nm
        power = optics.background_power(background.radiance, self.sipm.area)
        if not (self.spectral or isinstance(self.sipm.pde, Curve)):
            return float(self.sipm.count_rate(power, 1e-9 * background_nm))
        daylight = background.provenance.get("daylight")
        # without a record of the daylight its spectrum counts as flat
        irradiance = Daylight.model_validate(daylight).spectrum if daylight else np.ones_like
        # `background_power` takes the spectrum as flat over the filter. Its width and transmission
        # are divided out [W nm-1]: the integral of `background_counted` [nm] has the filter in it.
        per_nm = power / (optics.equivalent_width_nm * optics.peak_transmission)
        energy = photon_energy(1e-9 * background_nm)
        return per_nm * background_counted(self, background_nm, irradiance) / energy

    def levels(self, power: ArrayLike) -> tuple[Floats, Floats]:
        """Return the primary count rates of long zeros and long ones [s-1].

        Dark and background counts are included, and the saturation of the cells if it is on.

        Parameters
        ----------
        power : array_like
            Optical power on the SiPM [W], any shape.
        """
        low, high = self._rates(power)
        if not self.saturation:
            return low, high
        return self.sipm.saturated_rate(low), self.sipm.saturated_rate(high)

    def shot_levels(self, power: ArrayLike) -> tuple[Floats, Floats]:
        """Return the rates of Poisson counts with the shot noise of long zeros and ones [s-1].

        These are `levels`, times the Fano factor of saturated cells if the noise is renewal noise.

        Parameters
        ----------
        power : array_like
            Optical power on the SiPM [W], any shape.
        """
        low, high = self.levels(power)
        if not self.renewal_noise:
            return low, high
        # the Fano factor is a function of the rate before saturation
        fano_zero, fano_one = (self.sipm.fano_factor(rate) for rate in self._rates(power))
        return low * fano_zero, high * fano_one

    @property
    def renewal_noise(self) -> bool:
        """Whether the shot noise has the Fano factor of saturated cells."""
        chosen = self.saturation_noise
        if chosen == "auto" and self.background_rate > 0.0 and not self.receiver.exact_counts:
            chosen = "renewal"
        return self.saturation and chosen == "renewal"

    def _rates(self, power: ArrayLike) -> tuple[Floats, Floats]:
        """Return the primary count rates of long zeros and ones before saturation [s-1]."""
        signal = self.count_rate(non_negative("power", power, _MOST_POWER))
        constant = self.sipm.dark_count_rate + self.background_rate
        low, high = self.led.levels(signal)
        # dark and background counts do not follow the bits: no extinction ratio applies to them
        return low + constant, high + constant

    def patterns(self) -> NDArray[np.bool_]:
        """Return all p patterns of the k bits that matter (p, k).

        The columns are the present bit, the earlier ones (latest first), and the next ones.
        """
        filters = self.filters
        # behind a channel the sample is late, and light of the next bits may be in it
        ahead = min(filters.bits_ahead(self.bit_time), self.memory - 1)
        earlier = filters.mean_cursors(self.bit_time, self.memory)[: self.memory - ahead]
        # every further bit doubles the patterns: bits whose tail has died out are left out
        last = np.flatnonzero(earlier > _NEGLIGIBLE_CURSOR).max(initial=0)
        count = 1 + int(last) + ahead
        return np.array(np.unravel_index(np.arange(2**count), (2,) * count)).T.astype(bool)

    def equalized(self, count: Annotated[int, Field(ge=1, le=2**20)]) -> NDArray[np.bool_]:
        """Return which bits (count,), ordered as in `patterns`, decision feedback removes.

        These are the earlier ones, which the receiver has already decided; none without equaliser.
        """
        column = np.arange(count)
        earlier = (column > 0) & (column < count - self.filters.bits_ahead(self.bit_time))
        return earlier & (self.equalizer == "dfe")

    def moments(
        self, power: ArrayLike, phase: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    ) -> tuple[Floats, Floats]:
        """Return mean and variance of the sample for every bit pattern.

        Parameters
        ----------
        power : array_like
            Optical power on the SiPM [W], any shape.
        phase : float
            Sampling instant within the bit, 0 < phase <= 1.

        Returns
        -------
        tuple of ndarray
            Mean [s-1] and variance [s-2], shape of `power` with a last axis over `patterns`; the
            two patterns 0 and 1 for the models without intersymbol interference.
        """
        return self.receiver.moments(self, power, phase)

    def ber(self, power: ArrayLike) -> Floats:
        """Return the bit error rate at a constant received power.

        Parameters
        ----------
        power : array_like
            Optical power on the SiPM [W] in the sense of `led.power` (average unless
            `power_is_peak`), any shape; see `received_power`.

        Returns
        -------
        ndarray
            Bit error rate, same shape; 0.5 without light.

        Raises
        ------
        Refused
            If a power is negative or not finite.
        """
        p = non_negative("power", power, _MOST_POWER)
        flat = p.ravel()
        ber = np.full(flat.shape, 0.5)
        nonzero = np.flatnonzero(flat > 0.0)
        for start in range(0, nonzero.size, _BLOCK):
            block = nonzero[start : start + _BLOCK]
            ber[block] = self.receiver.decide(self, flat[block]).ber
        return ber.reshape(p.shape)

    def threshold(self, power: Annotated[float, Field(gt=0.0, lt=_MOST_POWER)]) -> float:
        """Return the best decision threshold at a received power.

        Parameters
        ----------
        power : float
            Optical power on the SiPM [W], > 0.

        Returns
        -------
        float
            Threshold on the sample [s-1], in primary counts per second like `levels`; take it
            from model CP for a real receiver, see the class's notes.

        Raises
        ------
        Refused
            If the power is not positive and finite.
        """
        return float(self.receiver.decide(self, np.array([power])).threshold[0])

    def required_power(self, ber: ErrorRate) -> float:
        """Return the lowest optical power on the SiPM that reaches a bit error rate.

        Parameters
        ----------
        ber : float
            Target, 0 < ber < 0.5.

        Returns
        -------
        float
            Power [W]; infinite if no power reaches the target (closed eye).

        Raises
        ------
        Refused
            If the target is outside of its range.
        """
        return _required_power(self.on_detector, ber)

    def overload_power(self, ber: float) -> float:
        """Return the highest optical power on the SiPM that still reaches a bit error rate.

        Parameters
        ----------
        ber : float
            Target, 0 < ber < 0.5.

        Returns
        -------
        float
            Power [W] above which the saturated cells no longer tell ones from zeros; infinite if
            that does not happen, or if no power reaches the target.
        """
        low = self.required_power(ber)
        if not self.saturation or self.sipm.recovery_time == 0.0 or math.isinf(low):
            return math.inf
        # The search starts just above the required power, which is the other root: rounding may
        # put the error rate there on the wrong side of the limit.
        return _crossing(self, ber, 1.001 * low, -1.0)

    def eye(
        self,
        power: Annotated[float, Field(gt=0.0, lt=_MOST_POWER)],
        points: Annotated[int, Field(ge=1, le=10_000)] = 64,
    ) -> Eye:
        """Return the eye diagram and bathtub curve at one received power (Gaussian noise).

        Parameters
        ----------
        power : float
            Optical power on the SiPM [W].
        points : int
            Instants within the bit.

        Returns
        -------
        Eye
            Levels, noise and error rate over the bit.

        Raises
        ------
        Refused
            If the model has no pulses (G0, GP), or the power is not positive.
        """
        if not self.receiver.has_pulses:
            raise Refused("model", self.model, "a model with pulses, as W, A, CP, PC")
        bits = self.patterns()
        phases = np.arange(1, points + 1) / points
        moments = [self.moments(power, float(phase)) for phase in phases]
        # (points, patterns)
        level, variance = (np.stack(part) for part in zip(*moments, strict=True))
        std = np.sqrt(variance)
        ber = pattern_decision(level, std, bits[:, 0]).ber
        low, high = self.levels(power)
        return Eye(phases * self.bit_time, level.T, std.T, bits, ber, float(high - low))


@functools.lru_cache(maxsize=1024)
def _required_power(link: OokLink, ber: float) -> float:
    """Return the lowest power that reaches a bit error rate, or inf [W]."""
    counts_per_joule = float(link.count_rate(1.0))
    if counts_per_joule == 0.0:
        return math.inf
    # 1e-9 counts in a bit: too little light for any target
    start = 1e-9 * link.bit_rate / counts_per_joule
    # Eleven steps of `_crossing` further, 4e-3 counts in a bit rarely suffice: most searches can
    # begin there, on the same steps.
    likely = start * 4.0**11

    receiver = link.receiver
    # An eye that intersymbol interference closes stays closed at any power. One error rate, at the
    # greatest power and without saturation, tells so and spares the search.
    if receiver.has_pulses and not receiver.exact_counts:
        if float(link.replace(saturation=False).ber(_MOST_POWER)) >= ber:
            return math.inf
    return _crossing(link, ber, likely if float(link.ber(likely)) >= ber else start)


def _crossing(link: OokLink, ber: float, start: float, sign: float = 1.0) -> float:
    """Return the first power at which the error rate falls below `ber`, or inf [W].

    It is sought upwards from `start` [W], where the rate is higher, in factors of 4. With a `sign`
    of -1 it is the power at which the rate rises above `ber`.
    """
    from scipy.optimize import brentq

    def excess(power: ArrayLike) -> Floats:
        # logarithms make it smooth over decades of power; 1e-300 keeps an underflow finite
        return sign * np.log(np.maximum(link.ber(power), 1e-300) / ber)

    # Small steps: saturated cells close the eye again, and a wide bracket could hold both roots.
    # 45 of them span 27 decades; `_MOST_POWER` ends most searches sooner.
    powers = start * 4.0 ** np.arange(1, 46)
    powers = powers[powers <= _MOST_POWER]
    # several powers take the time of one, but where each has a law of its own
    width = 1 if link.receiver.exact_counts else 15
    for first in range(0, len(powers), width):
        below = np.flatnonzero(excess(powers[first : first + width]) < 0.0)
        if below.size:
            high = powers[first + below[0]]
            bracket = math.log(0.25 * high), math.log(high)
            return math.exp(float(brentq(lambda x: excess(math.exp(x)), *bracket, xtol=1e-8)))
    return math.inf
