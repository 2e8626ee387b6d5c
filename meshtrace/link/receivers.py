"""Apertures in air and water, and irradiance planes."""

from __future__ import annotations

import math
from abc import abstractmethod
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from meshtrace.checks import Shape
from meshtrace.errors import Refused
from meshtrace.link.sources import Placed
from meshtrace.models import Family, Finite, Floats, Model, Positive
from meshtrace.optics.fresnel import unit_vector

__all__ = [
    "IrradiancePlanes",
    "Receiver",
    "WaterAperture",
    "WaterReceiver",
]


_WIDEST_IMAGE = 170.0  # [deg], full field of view of an image; its tangent diverges at 180


class Aperture(
    Placed,
    Family,
    frozen=True,
    default="receiver",
    closed="apertures are closed: the kernels score these alone",
):
    """Base of all apertures; a closed family, because the kernels score each kind themselves.

    Parameters
    ----------
    radius : float
        Aperture radius [m], > 0.
    fov_deg : float
        Full angle of the field of view [deg], 0 < fov <= 180.
    """

    radius: Positive = 0.05
    fov_deg: float = Field(default=180.0, gt=0.0, le=180.0, allow_inf_nan=False)

    @property
    @abstractmethod
    def axis(self) -> tuple[float, float, float]:
        """Direction of light at normal incidence."""

    def azimuths_of(self, directions: Annotated[Floats, Shape("n 3")]) -> Floats:
        """Return the azimuths [rad] from which light along directions (n, 3) arrives.

        About the line of sight, counter-clockwise seen from above from the x axis of the image: x
        and y turned with the line of sight by the shortest way from the vertical.
        """
        sight = -np.array(self.axis)
        vertical = np.array([0.0, 0.0, math.copysign(1.0, sight[2])])
        middle = sight + vertical
        # rotation of a vector e across the vertical v to the unit vector s (Rodrigues),
        # e - (s + v) (s . e) / (1 + s . v)
        image = np.eye(3)[:2] - np.outer(sight[:2] / (1.0 + sight @ vertical), middle)
        x, y = -image @ directions.T
        return np.asarray(np.arctan2(y, x))


class Camera(Aperture, frozen=True):
    """Base of receivers whose field of view may be divided into pixels.

    Parameters
    ----------
    pixels : int
        Pixels along each side of a square array in the focal plane of a lens without distortion,
        1 ... 32. Pixel (i, j) sees the light whose tangents (x, y) to the line of sight are in
        the i-th and j-th of as many equal parts from -tan(fov / 2) to tan(fov / 2), along the axes
        of the image, see `azimuths_of`. The round field of view leaves the corners dark.
    """

    pixels: int = Field(default=1, ge=1, le=32)

    @model_validator(mode="after")
    def _flat_image(self) -> Self:
        if self.pixels > 1 and self.fov_deg >= _WIDEST_IMAGE:
            allowed = f"< {_WIDEST_IMAGE:g} with pixels: a flat array has no image of the horizon"
            raise Refused("fov_deg", self.fov_deg, allowed)
        return self

    @property
    def pixel_edges(self) -> Floats:
        """Tangents at the edges of the pixels along either axis of the image, (pixels + 1,)."""
        edge = math.tan(math.radians(0.5 * self.fov_deg))
        return np.linspace(-edge, edge, self.pixels + 1)

    def pixels_of(self, angle: Floats, azimuth: Floats) -> NDArray[np.int64]:
        """Return the numbers i * pixels + j of the pixels (i, j) that see light, shape (n,).

        `angle` is that to the axis, `azimuth` of the side that the light comes from [rad].
        """
        tangent = np.tan(np.minimum(angle, math.radians(0.5 * self.fov_deg)))
        place = np.array([tangent * np.cos(azimuth), tangent * np.sin(azimuth)])
        part = np.searchsorted(self.pixel_edges[1:-1], place, side="right")
        return np.asarray(part[0] * self.pixels + part[1], np.int64)


class Receiver(Camera, frozen=True):
    """Disk that collects light in the air.

    A photon counts if it meets the disk within the field of view: |q - center| <= radius and
    d . axis >= cos(fov / 2).

    Parameters
    ----------
    height : float
        Height above still water [m], > 0.
    radius : float
        Radius of the aperture [m], > 0.
    fov_deg : float
        Full angle of the field of view [deg], 0 < fov <= 180.
    position : tuple of float
        Horizontal position (x, y) [m].
    tilt_deg, tilt_azimuth_deg : float
        Tilt of the line of sight from straight down, 0 <= tilt <= 180, and its azimuth from +x,
        counter-clockwise [deg].
    pixels : int
        Pixels along each side of a square array that divides the field of view, 1 ... 32.

    Notes
    -----
    It does not stop the light: light of a lamp in the air that the sea sends back through it counts
    again. The paper tests the position of the surface crossing instead of the angle (eq.
    condition_2), which accepts a superset: `Physics(fov="paper_position")`.
    """

    kind: Literal["receiver"] = "receiver"
    height: Positive = 5.0
    fov_deg: float = Field(default=60.0, gt=0.0, le=180.0, allow_inf_nan=False)
    tilt_deg: float = Field(default=0.0, ge=0.0, le=180.0, allow_inf_nan=False)
    tilt_azimuth_deg: Finite = 0.0

    @property
    def axis(self) -> tuple[float, float, float]:
        """Direction of light at normal incidence: opposite to the line of sight."""
        # the line of sight (x, y, -z) leans from nadir;
        # light at normal incidence travels against it
        x, y, z = unit_vector(self.tilt_deg, self.tilt_azimuth_deg)
        return (-x, -y, z)


class WaterAperture(Aperture, frozen=True):
    """Disk that counts light in the water without stopping it.

    Parameters
    ----------
    depth : float
        Depth of its centre [m], > 0.
    radius : float
        Radius [m], > 0.
    fov_deg : float
        Full angle of the field of view [deg], 0 < fov <= 180.
    zenith_deg, azimuth_deg : float
        Direction of the light at normal incidence; 0 counts light that goes up, 180 down.
    """

    kind: Literal["water-aperture"] = "water-aperture"
    depth: Positive = 1.0
    zenith_deg: float = Field(default=0.0, ge=0.0, le=180.0, allow_inf_nan=False)
    azimuth_deg: Finite = 0.0

    @property
    def axis(self) -> tuple[float, float, float]:
        """Direction of light at normal incidence."""
        return unit_vector(self.zenith_deg, self.azimuth_deg)


class WaterReceiver(Camera, frozen=True):
    """Disk that collects light in the water.

    Parameters
    ----------
    depth : float
        Depth of its centre below still water [m], > 0.
    radius : float
        Radius of the aperture [m], > 0.
    fov_deg : float
        Full angle of the field of view [deg], 0 < fov <= 180.
    position : tuple of float
        Horizontal position (x, y) [m].
    tilt_deg, tilt_azimuth_deg : float
        The receiver looks up; tilt leans its line of sight from straight up towards the azimuth
        (from +x counter-clockwise) [deg], 0 <= tilt <= 180.
    pixels : int
        Pixels along each side of a square array that divides the field of view, 1 ... 32.

    Notes
    -----
    It does not stop the light: light that scattering sends through it again counts again.
    """

    kind: Literal["water-receiver"] = "water-receiver"
    depth: float = Field(default=10.0, gt=0.0, le=12_000.0, allow_inf_nan=False)
    fov_deg: float = Field(default=60.0, gt=0.0, le=180.0, allow_inf_nan=False)
    tilt_deg: float = Field(default=0.0, ge=0.0, le=180.0, allow_inf_nan=False)
    tilt_azimuth_deg: Finite = 0.0

    @property
    def axis(self) -> tuple[float, float, float]:
        """Direction of light at normal incidence: opposite to the line of sight."""
        # the line of sight (x, y, z) leans from the zenith;
        # light at normal incidence travels against it
        x, y, z = unit_vector(self.tilt_deg, self.tilt_azimuth_deg)
        return -x, -y, -z


class IrradiancePlanes(Model, frozen=True):
    """Horizontal planes in the water with tallies of irradiance and radiance.

    Parameters
    ----------
    depths : tuple of float
        Depths [m], > 0, rising.
    n_cosines, n_azimuths : int
        Bins of the radiance in the cosine of the zenith angle of the light's travel and in its
        azimuth: from +1, straight up, to -1; 0 for none.
    """

    depths: tuple[Annotated[float, Field(gt=0.0, allow_inf_nan=False)], ...]
    n_cosines: int = Field(default=0, ge=0, le=1000)
    n_azimuths: int = Field(default=1, ge=1, le=1000)

    @field_validator("depths")
    @classmethod
    def _rising(cls, depths: tuple[float, ...]) -> tuple[float, ...]:
        if not depths or any(b <= a for a, b in pairwise(depths)):
            raise Refused("depths", depths, "at least one depth, strictly rising")
        return depths
