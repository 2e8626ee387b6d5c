"""Light sources under water and in the air."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from meshtrace.link.photometry import Photometry, frame, read_photometry
from meshtrace.link.tracker import Tracker
from meshtrace.models import Family, Finite, Model, NonNegative, Position, Positive
from meshtrace.optics.fresnel import unit_vector

__all__ = [
    "AirBeam",
    "AirLed",
    "AirMeasuredLamp",
    "AirTopHatBeam",
    "CardioidalSky",
    "GaussianBeam",
    "IsotropicSource",
    "Led",
    "MeasuredLamp",
    "Sun",
    "TopHatBeam",
    "UniformSky",
]


class Placed(Model, frozen=True):
    """Base of sources and apertures: models with a horizontal position.

    Parameters
    ----------
    position : tuple of float
        Horizontal position (x, y) [m].
    """

    position: Position = (0.0, 0.0)

    @property
    def center(self) -> tuple[float, float, float]:
        """Centre (x, y, z) [m]: z is the height, less the depth, or 0 for parts without either."""
        # 0.0 minus the depth: the sign alone would make -0.0 of 0.0
        return (*self.position, getattr(self, "height", 0.0 - getattr(self, "depth", 0.0)))


class Source(
    Placed,
    Family,
    frozen=True,
    default="led",
    closed="sources are closed: the kernels sample these alone",
):
    """Base of all sources; a closed family, because the kernels sample each kind themselves.

    Parameters
    ----------
    power_mw : float
        Emitted optical power [mW], > 0; the weight of the source in a list of sources.
    wavelength_nm : float
        Wavelength in vacuum [nm], 200 ... 1200.
    """

    synonyms: ClassVar[dict[str, str]] = {
        "laser": "gaussian-beam",
        "beam": "gaussian-beam",
        "lambertian": "led",
        "lamp": "led",
    }

    power_mw: Positive = 100.0
    wavelength_nm: float = Field(default=470.0, ge=200.0, le=1200.0, allow_inf_nan=False)

    @property
    def axis(self) -> tuple[float, float, float]:
        """Unit vector of the emission, straight down by default."""
        return (0.0, 0.0, -1.0)

    @property
    def size(self) -> float:
        """Radius of the emitting disk or half-width of the illuminated square [m], else 0."""
        return 0.0

    @property
    def pattern(self) -> str:
        """Name of the angular pattern: the kind of the underwater source with the same one."""
        return str(getattr(self, "kind", ""))


class _Lambertian(Model, frozen=True):
    """Pattern of an LED, I ~ cos^m(theta)."""

    half_angle_deg: float = Field(default=10.0, ge=1e-3, lt=90.0, allow_inf_nan=False)

    pattern: ClassVar[str] = "led"

    @property
    def spread_deg(self) -> float:
        """Half-angle at half the intensity on the axis [deg]."""
        return self.half_angle_deg

    @property
    def order(self) -> float:
        """Order m of I ~ cos^m(theta)."""
        # cos^m at the half-angle is 1/2
        return -math.log(2.0) / math.log(math.cos(math.radians(self.half_angle_deg)))


class _Gaussian(Model, frozen=True):
    """Pattern of a beam, Gaussian in position and in angle."""

    divergence_deg: float = Field(default=1.0, ge=0.0, lt=60.0, allow_inf_nan=False)
    waist: NonNegative = 0.0
    tracker: Tracker | None = None

    pattern: ClassVar[str] = "gaussian-beam"

    @property
    def size(self) -> float:
        """Radius at 1/e^2 of the on-axis irradiance at the source [m]."""
        return self.waist

    @property
    def spread_deg(self) -> float:
        """Half-angle at 1/e^2 of the on-axis intensity [deg]."""
        return self.divergence_deg


class _TopHat(Model, frozen=True):
    """Pattern of a beam, uniform over a disk and over a cone."""

    divergence_deg: float = Field(default=1.0, ge=0.0, le=90.0, allow_inf_nan=False)
    radius: NonNegative = 0.0
    tracker: Tracker | None = None

    pattern: ClassVar[str] = "top-hat-beam"

    @property
    def size(self) -> float:
        """Radius of the emitting disk [m]."""
        return self.radius

    @property
    def spread_deg(self) -> float:
        """Half-angle of the emitted cone [deg]."""
        return self.divergence_deg


class _Measured(Model, frozen=True):
    """Measured pattern of a lamp, from a file."""

    file: str
    roll_deg: Finite = 0.0

    pattern: ClassVar[str] = "table"

    @field_validator("file")
    @classmethod
    def _readable(cls, file: str) -> str:
        read_photometry(file)
        return file

    @property
    def photometry(self) -> Photometry:
        """Intensities of the file."""
        return read_photometry(self.file)

    @property
    def spread_deg(self) -> float:
        """Half-angle beyond which the intensity is below half of the largest [deg]."""
        return max(math.degrees(self.photometry.half_angle), 1e-3)

    @property
    def sides(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Unit vectors across the axis, along the planes C0 and C90 of the file."""
        rest = 1.0 if isinstance(self, WaterSource) else -1.0
        return frame(self.axis, rest, math.radians(self.roll_deg))  # type: ignore[attr-defined]


class WaterSource(Source, frozen=True):
    """Base of the sources in the water, with a depth and an axis.

    Parameters
    ----------
    depth : float
        Depth below still water [m], 0 < depth <= 12 000.
    zenith_deg, azimuth_deg : float
        Zenith angle of the axis, 0 for straight up, and its azimuth from +x [deg].
    """

    depth: float = Field(default=10.0, gt=0.0, le=12_000.0, allow_inf_nan=False)
    zenith_deg: float = Field(default=0.0, ge=0.0, le=180.0, allow_inf_nan=False)
    azimuth_deg: Finite = 0.0

    @property
    def spread_deg(self) -> float:
        """Half-angle of the emitted cone [deg], all directions by default."""
        return 180.0

    @property
    def axis(self) -> tuple[float, float, float]:
        """Unit vector of the emission."""
        return unit_vector(self.zenith_deg, self.azimuth_deg)


class Led(_Lambertian, WaterSource, frozen=True):
    """Lambertian LED under water, I(theta) = (m + 1) / (2 pi) cos^m(theta) per unit power.

    Parameters
    ----------
    depth : float
        Depth below still water [m], 0 < depth <= 12 000.
    half_angle_deg : float
        Half-angle at half power theta_1/2 [deg], 0.001 <= theta_1/2 < 90; the order is
        m = -ln 2 / ln cos theta_1/2.
    position : tuple of float
        Horizontal position (x, y) [m].
    zenith_deg, azimuth_deg : float
        Zenith angle of the axis, 0 for straight up, and its azimuth from +x [deg].
    power_mw : float
        Emitted optical power [mW], > 0; the weight of the source in a list of sources.
    wavelength_nm : float
        Wavelength in vacuum [nm], 200 ... 1200.

    Notes
    -----
    Paper, text below eq. theta_phi_ini.

    Examples
    --------
    >>> round(Led(half_angle_deg=10.0).order, 6)
    45.277602
    """

    kind: Literal["led"] = "led"


class GaussianBeam(_Gaussian, WaterSource, frozen=True):
    """Laser-like beam: Gaussian in position and in angle, 1/e^2 at waist and divergence.

    Parameters
    ----------
    divergence_deg : float
        Half-angle at 1/e^2 of the on-axis intensity [deg], 0 <= divergence < 60.
    waist : float
        Radius at 1/e^2 of the on-axis irradiance at the source [m], >= 0.
    tracker : Tracker, optional
        Tracker that steers the beam in time; by default the beam is fixed.
    """

    kind: Literal["gaussian-beam"] = "gaussian-beam"


class TopHatBeam(_TopHat, WaterSource, frozen=True):
    """Beam uniform over a disk and over a cone of directions.

    Parameters
    ----------
    divergence_deg : float
        Half-angle of the cone [deg], 0 <= divergence <= 90.
    radius : float
        Radius of the disk [m], >= 0.
    tracker : Tracker, optional
        Tracker that steers the beam in time; by default the beam is fixed.
    """

    kind: Literal["top-hat-beam"] = "top-hat-beam"


class IsotropicSource(WaterSource, frozen=True):
    """Point source that shines equally in all directions."""

    kind: Literal["isotropic"] = "isotropic"


class MeasuredLamp(_Measured, WaterSource, frozen=True):
    """Lamp under water with the measured intensities of an IES or EULUMDAT file.

    Parameters
    ----------
    file : str
        Path of an IES file (LM-63), or of a EULUMDAT file with the ending .ldt; the pattern is that
        of the file, the power `power_mw`.
    roll_deg : float
        Turn of the lamp about its axis [deg]. Straight up or down, the plane C0 of the file lies
        along +x without it; C runs counter-clockwise as seen from behind the lamp.

    Notes
    -----
    The lamp is a point. `meshtrace.link.photometry` states how the formats are read.
    """

    kind: Literal["measured-lamp"] = "measured-lamp"


class AirLamp(Source, frozen=True):
    """Base of the lamps in the air, with a height and an axis that leans from straight down.

    Parameters
    ----------
    height : float
        Height above still water [m], > 0.
    tilt_deg, tilt_azimuth_deg : float
        Tilt of the axis from straight down, 0 <= tilt <= 180, and its azimuth from +x [deg].
    """

    height: Positive = 5.0
    tilt_deg: float = Field(default=0.0, ge=0.0, le=180.0, allow_inf_nan=False)
    tilt_azimuth_deg: Finite = 0.0

    @property
    def axis(self) -> tuple[float, float, float]:
        """Unit vector of the emission."""
        # `unit_vector` counts from straight up, the tilt from straight down
        x, y, z = unit_vector(self.tilt_deg, self.tilt_azimuth_deg)
        return x, y, -z

    @property
    @abstractmethod
    def spread_deg(self) -> float:
        """Half-angle of the emitted cone [deg]."""


class AirLed(_Lambertian, AirLamp, frozen=True):
    """Lambertian LED in the air that shines down, with the pattern of `Led`.

    Parameters
    ----------
    height : float
        Height above still water [m], > 0.
    half_angle_deg : float
        Half-angle at half power [deg], 0.001 <= theta_1/2 < 90.
    position : tuple of float
        Horizontal position (x, y) [m].
    tilt_deg, tilt_azimuth_deg : float
        The lamp shines down; tilt leans its axis from nadir towards the azimuth (from +x
        counter-clockwise) [deg], 0 <= tilt <= 180.
    power_mw : float
        Emitted optical power [mW], > 0; the weight of the source in a list of sources.
    wavelength_nm : float
        Wavelength in vacuum [nm], 200 ... 1200.

    Examples
    --------
    >>> from meshtrace.link import Link, WaterReceiver
    >>> Link(transmitter=AirLed(height=5.0), receiver=WaterReceiver(depth=10.0)).direction
    'down'
    """

    kind: Literal["air-led"] = "air-led"


class AirBeam(_Gaussian, AirLamp, frozen=True):
    """Gaussian beam in the air that shines down, with the pattern of `GaussianBeam`.

    Parameters
    ----------
    height, position, tilt_deg, tilt_azimuth_deg, power_mw, wavelength_nm
        As those of `AirLed`.
    divergence_deg : float
        Half-angle at 1/e^2 of the on-axis intensity [deg], 0 <= divergence < 60.
    waist : float
        Radius at 1/e^2 of the on-axis irradiance at the source [m], >= 0.
    tracker : Tracker, optional
        Tracker that steers the beam in time; by default the beam is fixed.
    """

    kind: Literal["air-gaussian-beam"] = "air-gaussian-beam"


class AirTopHatBeam(_TopHat, AirLamp, frozen=True):
    """Beam in the air that shines down, uniform over a disk and over a cone, as `TopHatBeam`.

    Parameters
    ----------
    height, position, tilt_deg, tilt_azimuth_deg, power_mw, wavelength_nm
        As those of `AirLed`.
    divergence_deg : float
        Half-angle of the cone [deg], 0 <= divergence <= 90.
    radius : float
        Radius of the disk [m], >= 0.
    tracker : Tracker, optional
        Tracker that steers the beam in time; by default the beam is fixed.
    """

    kind: Literal["air-top-hat-beam"] = "air-top-hat-beam"


class AirMeasuredLamp(_Measured, AirLamp, frozen=True):
    """Lamp in the air that shines down, with the measured pattern of `MeasuredLamp`.

    Parameters
    ----------
    height, position, tilt_deg, tilt_azimuth_deg, power_mw, wavelength_nm
        As those of `AirLed`.
    file, roll_deg
        As those of `MeasuredLamp`.
    """

    kind: Literal["air-measured-lamp"] = "air-measured-lamp"


class AirSource(Source, frozen=True):
    """Base of the sun and the skies: light on a square of the sea.

    Parameters
    ----------
    half_width : float
        Half-width of the lit square at still water [m], > 0.
    """

    half_width: Positive = 5.0

    @property
    def size(self) -> float:
        """Half-width of the illuminated square [m]."""
        return self.half_width


class Sun(AirSource, frozen=True):
    """Collimated light from the air onto a square of the sea.

    Parameters
    ----------
    zenith_deg : float
        Zenith angle of the sun in air [deg], 0 <= zenith < 89.
    azimuth_deg : float
        Direction that the light travels to, from +x counter-clockwise [deg].
    half_width : float
        Half-width of the lit square at still water [m], > 0; every photon starts on it.
    position : tuple of float
        Centre of the square [m].

    Notes
    -----
    Tallies over whole horizontal planes, divided by the power, are those of an infinitely wide
    beam of unit power per unit area: E of the plane over E_d just above the sea.
    """

    kind: Literal["sun"] = "sun"
    zenith_deg: float = Field(default=0.0, ge=0.0, lt=89.0, allow_inf_nan=False)
    azimuth_deg: Finite = 0.0

    @property
    def axis(self) -> tuple[float, float, float]:
        """Unit vector of the direction in which the light travels, down."""
        # `azimuth_deg` is already that of the travel: z alone changes its sign
        x, y, z = unit_vector(self.zenith_deg, self.azimuth_deg)
        return x, y, -z


class UniformSky(AirSource, frozen=True):
    """Sky of uniform radiance over the upper hemisphere, onto a square of the sea."""

    kind: Literal["uniform-sky"] = "uniform-sky"


class CardioidalSky(AirSource, frozen=True):
    """Heavily overcast sky, L(theta) ~ 1 + 2 cos theta, onto a square of the sea.

    References
    ----------
    P. Moon and D. E. Spencer, "Illumination from a non-uniform sky", Illum. Eng. 37 (1942).
    """

    kind: Literal["cardioidal-sky"] = "cardioidal-sky"


ABOVE: dict[type[Source], type[AirLamp]] = {
    Led: AirLed,
    GaussianBeam: AirBeam,
    TopHatBeam: AirTopHatBeam,
    MeasuredLamp: AirMeasuredLamp,
}
"""Kinds of lamps in the air, by the kind in the water with the same pattern."""
