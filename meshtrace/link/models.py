"""What every part of a link is: a validated, frozen model; its types and unit vectors."""

from __future__ import annotations

import math
from typing import Annotated

import pydantic
from pydantic import Field

Finite = Annotated[float, Field(allow_inf_nan=False)]
Position = tuple[Finite, Finite]


class Model(pydantic.BaseModel, frozen=True, extra="forbid"):
    """Validated, frozen, comparable; loads back from its own `model_dump`."""


def unit_vector(zenith_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    """Return the unit vector of a zenith angle and an azimuth [deg]."""
    zenith, azimuth = math.radians(zenith_deg), math.radians(azimuth_deg)
    s = math.sin(zenith)
    return s * math.cos(azimuth), s * math.sin(azimuth), math.cos(zenith)
