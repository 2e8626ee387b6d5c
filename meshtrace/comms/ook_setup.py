"""Setup of an on-off keyed link: devices, receiver model, presets and calibration."""

from __future__ import annotations

from typing import Any, Literal, Self, get_args

import pydantic

from meshtrace.comms.devices import LedDriver, OpticalFrontEnd, SiPM, Tia
from meshtrace.comms.receiver_base import ReceiverModel
from meshtrace.errors import Refused, require_kind, require_word
from meshtrace.link import Link, Receiver
from meshtrace.models import Model, NonNegative

Preset = Literal["physical", "paper", "paper-ranges"]


class OokSetup(Model, frozen=True):
    """Devices and options of `OokLink`, and their relation to a `Link`."""

    bit_rate: float = pydantic.Field(default=1e6, gt=0.0, le=1e10, allow_inf_nan=False)
    led: LedDriver = LedDriver()
    sipm: SiPM = SiPM()
    tia: Tia = Tia()
    optics: OpticalFrontEnd = OpticalFrontEnd()
    model: str | pydantic.SerializeAsAny[ReceiverModel] = "W"
    background_rate: NonNegative = 0.0
    saturation: bool = True
    saturation_noise: Literal["auto", "renewal", "poisson"] = "auto"
    memory: int = pydantic.Field(default=8, ge=1, le=12)
    window: float | None = pydantic.Field(default=None, ge=0.0, allow_inf_nan=False)
    equalizer: Literal["none", "dfe"] = "none"
    calibration: Literal["none", "paper-ranges"] = "none"

    @pydantic.field_validator("model", mode="before")
    @classmethod
    def _known_model(cls, model: Any) -> str | ReceiverModel:
        found = ReceiverModel.read(model)
        kind = str(found.model_dump()["kind"])
        return found if found.model_dump(exclude_defaults=True) else kind

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.window is not None and self.window > self.bit_time * (1.0 + 1e-12):
            raise Refused("window", self.window, f"0 <= window <= {self.bit_time} s")
        if self.saturation_noise == "renewal" and self.receiver.exact_counts:
            allowed = "auto or poisson for models of exact counts (CP, GP)"
            raise Refused("saturation_noise", "renewal", allowed)
        return self

    @classmethod
    def preset(cls, name: Preset, **fields: Any) -> Self:
        """Return the physical receiver, that of the paper, or its empirical calibration.

        Parameters
        ----------
        name : {"physical", "paper", "paper-ranges"}
            "physical" is model W behind etendue-limited optics; "paper" model PC behind a loss-free
            lens; "paper-ranges" the same with its label set, see `status`.
        **fields
            Any other field of the class, such as `bit_rate`.

        Raises
        ------
        Refused
            If the name is none of the three.
        """
        require_word(name, get_args(Preset), "name")
        preset: dict[str, Any] = {}
        if name != "physical":
            preset = {"model": "PC", "optics": OpticalFrontEnd(etendue_limited=False)}
        if name == "paper-ranges":
            preset["calibration"] = name
        return cls(**(preset | fields))

    @classmethod
    def of_link(
        cls, link: Link, base: OokSetup | Preset = "physical", bit_rate: float | None = None
    ) -> Self:
        """Return the transmission that belongs to a link.

        Parameters
        ----------
        link : Link
            Source of the power, wavelength, aperture radius, field of view, and of the refractive
            index of the medium in front of the aperture.
        base : OokLink or preset
            Everything else.
        bit_rate : float, optional
            R_b [bit s-1]; by default that of `base`.

        Raises
        ------
        Refused
            If the preset is unknown, the bit rate does not fit, or the link has several receivers.

        Examples
        --------
        >>> from meshtrace.comms.ook import OokLink
        >>> from meshtrace.link import Led
        >>> OokLink.of_link(Link(transmitter=Led(power_mw=50.0)), bit_rate=5e6).led.power
        0.05
        """
        require_kind(link, Link, "link")
        if len(link.receivers) != 1:
            raise Refused("receiver", f"{len(link.receivers)} apertures", "one aperture")
        aperture: Any = link.receivers[0]
        first = link.transmitters[0]
        base = base if isinstance(base, OokSetup) else cls.preset(base)
        power = 1e-3 * sum(t.power_mw for t in link.transmitters)
        index = link.n_air if isinstance(aperture, Receiver) else link.water.n
        view = {"radius": aperture.radius, "fov_deg": aperture.fov_deg, "medium_index": index}
        changes = {
            "bit_rate": base.bit_rate if bit_rate is None else bit_rate,
            "led": base.led.replace(power=power, wavelength=first.wavelength_nm / 1e9),
            "optics": base.optics.replace(**view),
        }
        return cls.model_validate({**dict(base), **changes})

    def channel(self, link: Link) -> Link:
        """Return a link with the absorption scaled as the calibration requires.

        Parameters
        ----------
        link : Link
            The link; returned unchanged unless `calibration` is "paper-ranges".
        """
        require_kind(link, Link, "link")
        factor, water = self.absorption_factor, link.water
        if factor == 1.0:
            return link
        changes: dict[str, Any] = {"a": factor * water.a}
        if water.layers is not None:
            changes["layers"] = tuple((z, factor * a, b) for z, a, b in water.layers)
        return link.model_copy(update={"water": water.model_copy(update=changes)})

    @property
    def absorption_factor(self) -> float:
        """Factor on the water's absorption in the channel gain."""
        return 2.0 if self.calibration == "paper-ranges" else 1.0

    @property
    def status(self) -> str:
        """Standing of the calibration, shown with every result."""
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
