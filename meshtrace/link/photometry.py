"""Files of measured lamps, IES (LM-63) and EULUMDAT: intensity over angle and azimuth."""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused
from meshtrace.models import Floats

_LARGEST_FILE = 4 * 2**20  # [bytes]
_FINEST = math.radians(0.05)  # least step of a table over the angle to the axis [rad]
_COARSEST = math.radians(0.5)  # within which linear in the angle and in its haversine agree [rad]
_MOST_AZIMUTHS = 720
_SLOPE = 0.6  # sqrt(1 / e): largest slope of a Gaussian times its standard deviation


class Photometry:
    """Intensities of a lamp in C-planes (CIE 121), linear in the angles between the nodes.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Angles gamma to the axis of the lamp [rad], increasing; there is no light outside of them.
    azimuth : ndarray, shape (m,)
        Angles C about the axis [rad], 0 to 2 pi, the last one that of the first; both for m = 2.
    intensity : ndarray, shape (n, m)
        Luminous intensities [cd].
    """

    def __init__(self, theta: Floats, azimuth: Floats, intensity: Floats) -> None:
        self.theta, self.azimuth, self.intensity = theta, azimuth, intensity

    @cached_property
    def rings(self) -> tuple[Floats, float]:
        """Intensities at equal steps of both angles, up to the last light, and the step of theta.

        Shape (rings, azimuths), as `kernels.tables.packed` takes them; the step in radians.
        """
        finest = float(np.diff(self.theta).min())
        step = max(finest / math.ceil(finest / _COARSEST - 1e-9), _FINEST)
        step = math.pi / math.ceil(math.pi / step - 1e-9)
        theta = step * np.arange(round(math.pi / step) + 1)
        even = self.azimuth
        if len(even) > 2:
            turns = math.ceil(2.0 * math.pi / float(np.diff(even).min()) - 1e-9)
            even = np.linspace(0.0, 2.0 * math.pi, min(turns, _MOST_AZIMUTHS) + 1)
        at_azimuth = np.array([np.interp(even, self.azimuth, row) for row in self.intensity])
        # 1e-9: an angle of the file may be a rounding from that of a ring
        inside = np.clip(theta, self.theta[0], self.theta[-1])
        within = np.abs(theta - inside) < 1e-9
        columns = [np.interp(inside, self.theta, column) * within for column in at_azimuth.T]
        table = np.stack(columns, axis=1)
        last = int(np.flatnonzero(table.any(axis=1))[-1])
        return table[: min(last + 2, len(table))], step

    @cached_property
    def flux(self) -> float:
        """Luminous flux, int I dOmega [lm]."""
        table, step = self.rings
        mean = 0.5 * (table[:, 1:] + table[:, :-1]).mean(axis=1)
        cosine = np.cos(step * np.arange(len(table)))
        return float(math.pi * ((mean[1:] + mean[:-1]) * -np.diff(cosine)).sum())

    @cached_property
    def envelope(self) -> tuple[Floats, Floats]:
        """Angles to the axis [rad], and the largest intensity at these or beyond [sr-1].

        That of a lamp of unit power.
        """
        table, step = self.rings
        highest = np.maximum.accumulate(table.max(axis=1)[::-1])[::-1]
        return step * np.arange(float(len(table))), np.asarray(highest / self.flux)

    @property
    def half_angle(self) -> float:
        """Angle beyond which no intensity is above half of the largest [rad]."""
        theta, highest = self.envelope
        return float(theta[np.flatnonzero(highest >= 0.5 * highest[0])[-1]])

    @cached_property
    def scale(self) -> float:
        """Angle over which the intensity changes, as the standard deviation of a Gaussian [rad]."""
        table, step = self.rings
        slope = np.abs(np.diff(table, axis=0)).max() / step
        sine = np.sin(step * np.arange(len(table)))[1:-1, None]
        around = (
            np.abs(np.diff(table, axis=1))[1:-1] * (table.shape[1] - 1) / (2.0 * math.pi * sine)
        )
        steepest = max(slope, around.max(initial=0.0), 1e-300)
        return float(min(_SLOPE * table.max() / steepest, 1.0))


def read_photometry(path: str | PathLike[str]) -> Photometry:
    """Read the intensities of a lamp from a file.

    Parameters
    ----------
    path : path
        An IES file (LM-63-1986 to LM-63-2019) or, with the ending .ldt, a EULUMDAT file.

    Raises
    ------
    Refused
        If the file cannot be read, is none of these, has a photometry of type A or B, or states
        other symmetries or negative intensities.
    """
    file = Path(path)
    try:
        if not file.is_file() or file.stat().st_size > _LARGEST_FILE:
            raise Refused("file", Described(str(path)), "an IES or EULUMDAT file of at most 4 MB")
        status = file.stat()
    except OSError as error:
        raise Refused("file", Described(str(path)), "an IES or EULUMDAT file") from error
    return _read(file, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=32)
def _read(file: Path, *version: int) -> Photometry:
    """Read a file, cached by the parts of its status that change with it (`version`)."""
    text = file.read_text(encoding="latin-1")
    try:
        planes = _eulumdat(text) if file.suffix.lower() == ".ldt" else _ies(text)
        return Photometry(*planes)
    except Refused as error:
        raise error.in_file(str(file)) from error.__cause__
    except (ValueError, IndexError, OverflowError) as error:
        kind = "EULUMDAT" if file.suffix.lower() == ".ldt" else "IES (LM-63)"
        raise Refused("file", Described(f"{file}: {error}"), f"the numbers of {kind}") from error


def _ies(text: str) -> tuple[Floats, Floats, Floats]:
    """Return the angles and intensities [cd] of a file of LM-63."""
    _, mark, rest = text.partition("TILT=")
    if not mark:
        raise Refused("TILT", Described("no such line"), "a line TILT=NONE or TILT=INCLUDE")
    tilt, _, body = rest.partition("\n")
    numbers = iter(body.replace(",", " ").split())

    def floats(n: int) -> Floats:
        return np.array([float(next(numbers, "end of file")) for _ in range(n)])

    if tilt.strip().upper() == "INCLUDE":
        # how the light depends on the position of the lamp alters its power, not its pattern
        _, pairs = floats(2)
        floats(2 * int(pairs))
    elif tilt.strip().upper() != "NONE":
        raise Refused("TILT", tilt.strip(), "NONE or INCLUDE")
    _, _, multiplier, n_theta, n_azimuth, kind, units, *_ = floats(10)
    ballast, _, _ = floats(3)
    if kind != 1.0:
        raise Refused("photometric type", f"{kind:g}", "1: type C")
    if units not in (1.0, 2.0):
        raise Refused("units type", f"{units:g}", "1: feet, or 2: metres")
    n_theta, n_azimuth = _count(n_theta, "vertical angles"), _count(n_azimuth, "horizontal angles")
    if not (multiplier > 0.0 and ballast > 0.0):
        raise Refused("multiplier", f"{multiplier:g} x {ballast:g}", "numbers > 0")
    theta, azimuth = floats(n_theta), floats(n_azimuth)
    candela = multiplier * ballast * floats(n_theta * n_azimuth).reshape(n_azimuth, n_theta)
    if next(numbers, None) is not None:
        raise ValueError("more numbers than the angles have intensities")
    first, last = float(azimuth[0]), float(azimuth[-1])
    if n_azimuth == 1:
        planes = np.array([0.0, 360.0]), candela[[0, 0]]
    elif (first, last) == (0.0, 90.0):
        planes = _mirrored(*_mirrored(azimuth, candela, 90.0), 180.0)
    elif (first, last) == (0.0, 180.0):
        planes = _mirrored(azimuth, candela, 180.0)
    elif (first, last) == (90.0, 270.0):
        planes = _turned(*_mirrored(azimuth, candela, 270.0))
    elif first == 0.0 and last == 360.0:
        planes = azimuth, candela
    elif first == 0.0 and last > 180.0 and last + azimuth[1] == 360.0:
        planes = np.append(azimuth, 360.0), np.append(candela, candela[:1], axis=0)
    else:
        allowed = "0, 0 to 90, 0 to 180, 0 to 360 or 90 to 270 degrees"
        raise Refused("horizontal angles", Described(f"{first:g} to {last:g}"), allowed)
    return _checked(theta, *planes)


def _eulumdat(text: str) -> tuple[Floats, Floats, Floats]:
    """Return the angles and intensities [cd] of a EULUMDAT file."""
    lines = [line.strip().replace(",", ".") for line in text.splitlines()]

    def floats(first: int, n: int) -> Floats:
        if len(lines) < first + n:
            raise ValueError(f"ends at line {len(lines)} of {first + n}")
        return np.array([float(line) for line in lines[first : first + n]])

    symmetry = float(lines[2])
    n_azimuth, n_theta = _count(float(lines[3]), "C-planes"), _count(float(lines[5]), "angles")
    factor, tilt, sets = floats(23, 3)
    if tilt != 0.0:
        raise Refused("tilt of luminaire", f"{tilt:g}", "0: intensities about the axis of the lamp")
    if not factor > 0.0:
        raise Refused("conversion factor", f"{factor:g}", "a number > 0")
    number_of_sets = _count(sets, "sets of lamps")
    lumens = abs(float(lines[28]))  # negative for a flux that is that of the luminaire
    begin = 26 + 6 * number_of_sets + 10  # after the direct ratios of ten rooms
    azimuth, theta = floats(begin, n_azimuth), floats(begin + n_azimuth, n_theta)
    quarter, rest = divmod(n_azimuth, 4)
    # the planes that are given, of all: first and number
    spans = {0.0: (0, n_azimuth), 1.0: (0, 1), 2.0: (0, n_azimuth // 2 + 1),
             3.0: (3 * quarter, 2 * quarter + 1), 4.0: (0, quarter + 1)}  # fmt: skip
    if symmetry not in spans:
        raise Refused("Isym", lines[2], "0 to 4")
    if (symmetry == 2.0 and n_azimuth % 2) or (symmetry > 2.0 and rest):
        raise Refused("C-planes", n_azimuth, f"a number that fits the symmetry {symmetry:g}")
    first, n = spans[symmetry]
    values = floats(begin + n_azimuth + n_theta, n * n_theta).reshape(n, n_theta)
    # intensities are per 1000 lumens of the lamps
    candela = values * factor * (lumens / 1000.0 if lumens else 1.0)
    if symmetry == 1.0:
        return _checked(theta, np.array([0.0, 360.0]), candela[[0, 0]])
    angles = np.append(azimuth, azimuth + 360.0)[first : first + n]
    if symmetry == 0.0:
        angles, candela = np.append(angles, 360.0), np.append(candela, candela[:1], axis=0)
    elif symmetry == 3.0:
        # from C270 over C0 to C90, mirrored by the plane of both
        angles, candela = _turned(*_mirrored(angles - 360.0, candela, 90.0))
    else:
        for side in (90.0, 180.0) if symmetry == 4.0 else (180.0,):
            angles, candela = _mirrored(angles, candela, side)
    return _checked(theta, angles, candela)


def _count(number: float, what: str) -> int:
    """Return a number of items, 1 to 10 000."""
    if not (number == int(number) and 1 <= number <= 10_000):
        raise Refused(what, f"{number:g}", "1 to 10 000 of them")
    return int(number)


def _mirrored(azimuth: Floats, planes: Floats, side: float) -> tuple[Floats, Floats]:
    """Return planes up to an azimuth [deg] with their mirror images beyond it."""
    if abs(azimuth[-1] - side) > 1e-6:
        raise Refused("C-planes", Described(f"up to {azimuth[-1]:g}"), f"up to {side:g} degrees")
    return np.append(azimuth, 2.0 * side - azimuth[-2::-1]), np.append(planes, planes[-2::-1], 0)


def _turned(azimuth: Floats, planes: Floats) -> tuple[Floats, Floats]:
    """Return planes over a full turn as planes from 0 to 360 degrees, both ends included."""
    order = np.argsort(azimuth[:-1] % 360.0)
    azimuth, planes = (azimuth[:-1] % 360.0)[order], planes[:-1][order]
    if azimuth[0] != 0.0:
        raise Refused("C-planes", Described(f"first {azimuth[0]:g}"), "one at 0 degrees")
    return np.append(azimuth, 360.0), np.append(planes, planes[:1], axis=0)


def _checked(theta: Floats, azimuth: Floats, planes: Floats) -> tuple[Floats, Floats, Floats]:
    """Return angles [rad] and intensities (theta, azimuth) from angles [deg]; refuse bad data."""
    for name, angles, most in (("vertical", theta, 180.0), ("horizontal", azimuth, 360.0)):
        rising = len(angles) > 1 and (np.diff(angles) > 0.0).all()
        if not (rising and angles[0] >= 0.0 and angles[-1] <= most):
            raise Refused(f"{name} angles", Described(f"{angles[0]:g} to {angles[-1]:g}"),
                          f"increasing angles from 0 to {most:g} degrees")  # fmt: skip
    if (azimuth[0], azimuth[-1]) != (0.0, 360.0):
        raise Refused("horizontal angles", Described(f"first {azimuth[0]:g}"), "one at 0 degrees")
    if not (np.isfinite(planes).all() and planes.min() >= 0.0 and planes.max() > 0.0):
        raise Refused("intensities", Described("negative, infinite or all 0"), "numbers >= 0")
    return np.radians(theta), np.radians(azimuth), planes.T.copy()


def frame(
    axis: tuple[float, float, float], rest: float, roll: float
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the directions C0 and C90 of a lamp that was turned from the vertical to an axis.

    Parameters
    ----------
    axis : (float, float, float)
        Unit vector along gamma = 0.
    rest : {-1, 1}
        z of the axis of the lamp before the turn, when C0 is +x.
    roll : float
        Turn about the axis [rad] afterwards, from C0 to C90.
    """
    d, up = np.array(axis), np.array([0.0, 0.0, rest])
    # the least rotation (Rodrigues) takes x to x - d.x / (1 + up . d) (up + d)
    turned = 1.0 + float(up @ d)
    side = np.array([1.0, 0.0, 0.0])
    if turned > 1e-12:
        side = side - d[0] / turned * (up + d)
    side /= np.linalg.norm(side)
    # from behind the lamp C runs counter-clockwise: the frame is left-handed with the axis
    other = np.cross(side, d)
    c, s = math.cos(roll), math.sin(roll)
    return c * side + s * other, c * other - s * side
