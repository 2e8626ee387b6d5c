"""Numbers that the paper prints, with the place where it prints them."""

from __future__ import annotations

from typing import NamedTuple


class Printed(NamedTuple):
    """A printed number, its unit, and where it stands."""

    value: float
    unit: str
    place: str


_TILT_TEXT = "Section VI, text on the UAV deflection angle"
_FF_TEXT = "Section III, text on the approximate CDF"
_SURFACE_TEXT = "Section VI, text on the sea surfaces"
_WIND_TEXT = "Section VI, text on the channel gain over 10 000 realizations"
_ANGLE_TEXT = "Section VI, text on the half angle"
_BER_TEXT = "Section VI, text on the bit error rate"

_TABLE = "Section VI, table of the link's parameters"

PRINTED = {
    "depth": Printed(10.0, "m", _TABLE),
    "height": Printed(5.0, "m", _TABLE),
    "half-angle": Printed(10.0, "degree", _TABLE),
    "radius": Printed(0.05, "m", _TABLE),
    "ff-rmse": Printed(6.28e-4, "1", _FF_TEXT),
    "ff-mae": Printed(5.33e-4, "1", _FF_TEXT),
    "ff-ks": Printed(9.69e-4, "1", _FF_TEXT),
    "tilt-rmse-5": Printed(1.12e-2, "1/degree", _TILT_TEXT),
    "tilt-mae-5": Printed(7.71e-3, "1/degree", _TILT_TEXT),
    "tilt-ks-5": Printed(2.95e-2, "1", _TILT_TEXT),
    "tilt-kl-5": Printed(1.45e-3, "nat", _TILT_TEXT),
    "tilt-std-5": Printed(0.479, "degree", _TILT_TEXT),
    "tilt-rmse-13": Printed(2.5e-3, "1/degree", _TILT_TEXT),
    "tilt-mae-13": Printed(1.74e-3, "1/degree", _TILT_TEXT),
    "tilt-ks-13": Printed(6.9e-3, "1", _TILT_TEXT),
    "tilt-kl-13": Printed(3.13e-3, "nat", _TILT_TEXT),
    "tilt-std-13": Printed(3.04, "degree", _TILT_TEXT),
    "peak-to-peak-5": Printed(0.5, "m", _SURFACE_TEXT),
    "peak-to-peak-13": Printed(1.5, "m", _SURFACE_TEXT),
    "gain-5": Printed(1.58e-5, "1", _WIND_TEXT),
    "gain-13": Printed(1.32e-5, "1", _WIND_TEXT),
    "gain-ratio": Printed(1.32e-5 / 1.58e-5, "1", _WIND_TEXT + " (quotient of both)"),
    "gain-half-angle-5": Printed(6.8e-5, "1", _ANGLE_TEXT),
    "gain-half-angle-60": Printed(2.6e-6, "1", _ANGLE_TEXT),
    "loss-half-angle": Printed(14.0, "dB", _ANGLE_TEXT + ' ("more than")'),
    "loss-offset-5": Printed(1.35, "dB", "Section VI, text on the misalignment"),
    "loss-offset-13": Printed(2.05, "dB", "Section VI, text on the misalignment"),
    "range-0-5": Printed(43.0, "m", _BER_TEXT),
    "range-0-10": Printed(36.0, "m", _BER_TEXT),
    "loss-of-range-5-5": Printed(4.0, "m", _BER_TEXT),
    "loss-of-range-5-10": Printed(5.0, "m", _BER_TEXT),
    "loss-of-range-13": Printed(2.5, "m", _BER_TEXT),
    "range-13-1": Printed(47.0, "m", "Abstract (the text gives it for 2e-3)"),
    "mean-wind-x": Printed(5.0, "m/s", "Appendix B, caption of the wind records"),
    "mean-wind-y": Printed(5.0, "m/s", "Appendix B, caption of the wind records"),
}
"""What the paper prints, by key."""

STATIONS = ((165.91, -21.17), (167.33, -22.11), (165.45, -20.51))
"""Longitude and latitude [degrees east, north] of the stations, Appendix A."""

MODERATE_W20 = 30.0
"""Wind at 20 feet for moderate turbulence [kt], Appendix B."""
