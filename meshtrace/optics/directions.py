"""Directions of sources and apertures as unit vectors."""

from __future__ import annotations

import math


def unit_vector(zenith_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    """Return the unit vector of a zenith angle and an azimuth [deg]."""
    zenith, azimuth = math.radians(zenith_deg), math.radians(azimuth_deg)
    s = math.sin(zenith)
    return s * math.cos(azimuth), s * math.sin(azimuth), math.cos(zenith)
