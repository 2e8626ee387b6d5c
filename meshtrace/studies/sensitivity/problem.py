"""Gains of neighbouring links over the same seas, with common random numbers."""

from __future__ import annotations

import hashlib
import io
import json
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from meshtrace.errors import Refused, require_whole
from meshtrace.files import atomic
from meshtrace.link import Link
from meshtrace.mesh import RandomSea, TriangleMesh
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS
from meshtrace.studies.inputs import CommonLines
from meshtrace.studies.sensitivity.parameters import Setting
from meshtrace.transport.forced import MANY_SEAS, TypicalSea
from meshtrace.transport.frozen import FrozenForced, Light
from meshtrace.transport.meshing import FADING_SPACING
from meshtrace.transport.options import Meshing, Run

_KEPT = 4  # meshes of the base sea that stay in memory
_WIDEST_DEG = 4.0  # half-width of a window in angle at the edge of the field of view
_WINDOWS = 6  # of half the width each
_CLEAR = 1.5  # standard errors of its bias beyond which a window is too wide
_DIGEST = hashlib.sha256().digest_size
_EDGE_STEP = 0.01  # relative, of the field of view, for unscattered light


class Problem:
    """Base of a study: setting, options, seas and the chains that all evaluations share.

    Parameters
    ----------
    setting : Setting
        Link, surface and electronics.
    run : Run
        Photons, seed and threads.
    meshing : Meshing
        Time and resolution of the surface.
    realizations : int
        Seas; 1 is the surface as it is.

    Raises
    ------
    Refused
        If forced detection does not follow the link, or there are several seas of a surface
        without random phases.
    """

    def __init__(self, setting: Setting, run: Run, meshing: Meshing, realizations: int) -> None:
        require_whole(realizations, 1, 100_000, "realizations")
        sea = setting.sea
        if realizations > 1 and not isinstance(sea, RandomSea):
            kind = getattr(sea, "kind", type(sea).__name__)
            raise Refused("realizations", realizations, f"1 over a surface of kind {kind}")
        self.setting, self.run, self.meshing = setting, run, meshing
        self.realizations = realizations
        many = (run.seed, FADING_SPACING) if realizations > 1 else ()
        self._seas = CommonLines(setting.link, sea, meshing, *many)
        self._meshes = [self._seas.mesh(i) for i in range(min(realizations, _KEPT))]
        typical = TypicalSea.of(self._meshes, 1.0 if realizations == 1 else MANY_SEAS)
        self._frozen = FrozenForced(
            setting.link, run.photons, run.seed, typical, meshing.normals, meshes=self._meshes
        )

    def base_mesh(self, i: int) -> TriangleMesh:
        """Return realization i of the base sea; the first ones are kept."""
        return self._meshes[i] if i < len(self._meshes) else self._seas.mesh(i)

    def gains(self, setting: Setting, i: int) -> Floats:
        """Return the gain of the first receiver over realization i by shift, shape (shifts,)."""
        same = setting.sea is self.setting.sea
        mesh = self.base_mesh(i) if same else self._seas.mesh(i, setting.sea)
        return self._frozen.gains(setting.link, mesh)[0]

    def light(self, link: Link, i: int) -> Light:
        """Return the light that a neighbouring link receives over realization i."""
        return self._frozen.light(link, self.base_mesh(i))[0]

    def by_view(self, name: str, i: int) -> tuple[Floats, Floats]:
        """Return dh / d ln fov over realization i by shift, and its bias, likewise.

        Parameters
        ----------
        name : str
            Key of the field of view.
        i : int
            Number of the sea.

        Notes
        -----
        Unscattered light is integrated up to the edge, so that its difference over 1 % of the
        field of view has no noise; scattered light is that within a window about the edge.
        """
        link = self.setting.link
        fov = link.receivers[0].fov_deg
        views = [min(fov * math.exp(side * _EDGE_STEP), 180.0) for side in (-1.0, 1.0)]
        mesh = self.base_mesh(i)
        low, high = (self._frozen.unscattered(link.replace(name, v), mesh)[0] for v in views)
        wide = link.replace(name, min(fov + 2.0 * _WIDEST_DEG, 180.0))
        change, bias = edge_of_view(self.light(wide, i), 0.5 * fov)
        return change + (high - low) / math.log(views[1] / views[0]), bias


def has_moments(link: Link) -> bool:
    """Return whether a and b enter the weights alone, as powers of b and exp(-(a + b) L)."""
    plain = link.bubbles is None and link.water.layers is None
    return plain and link.physics.absorption != "paper"


def moments(link: Link, light: Light) -> dict[str, Floats]:
    """Return dh / d ln a and dh / d ln b by shift.

    dw / da = -L w, dw / db = (K / b - L) w
    """
    way = light.by_shift(light.water)
    scatterings = light.by_shift(light.order.astype(float))
    return {"water.a": -link.water.a * way, "water.b": scatterings - link.water.b * way}


def edge_of_view(light: Light, half_deg: float) -> tuple[Floats, Floats]:
    """Return dh / d ln fov of scattered light by shift, half_deg the half-angle, and its bias.

    The light per angle at the edge is that within a window (Epanechnikov), whose bias grows as
    the square of the width: 4/3 of the difference from the window of half the width. The widest
    window is taken whose bias is not clear from noise.
    """
    angle = np.degrees(light.angle)
    light = light._replace(weight=np.where(light.shift >= 0, light.weight, 0.0))
    found = []
    for k in range(_WINDOWS):
        width = min(_WIDEST_DEG, 0.5 * half_deg) / 2.0**k
        off = (angle - half_deg) / width
        window = np.where(np.abs(off) < 1.0, 0.75 * (1.0 - off**2), 0.0) / width
        found.append(half_deg * light.by_shift(window))
    for wide, narrow in pairwise(found):
        bias = 4.0 / 3.0 * (wide - narrow)
        noise = bias.std(ddof=1) / math.sqrt(SHIFTS)
        if abs(bias.mean()) <= _CLEAR * noise:
            break
    return wide, np.full(SHIFTS, bias.mean())


class Shelf:
    """Finished parameters of a run on disk, for a stopped run to resume.

    Parameters
    ----------
    folder : path, optional
        Folder of the files; None keeps nothing.
    key : mapping
        Everything that the numbers depend on but the parameter.
    """

    def __init__(self, folder: str | Path | None, key: dict[str, Any]) -> None:
        self._folder = None if folder is None else Path(folder)
        self._key = json.dumps(key, sort_keys=True)
        self._numbers: dict[str, Floats] = {}
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)

    def kept(self, name: str, make: Callable[[], Floats]) -> Floats:
        """Return the numbers of a parameter, made once."""
        if name not in self._numbers:
            folder = self._folder
            self._numbers[name] = make() if folder is None else self._filed(folder, name, make)
        return self._numbers[name]

    def _filed(self, folder: Path, name: str, make: Callable[[], Floats]) -> Floats:
        """Return the numbers in the file of a parameter, made unless it is an undamaged one.

        The SHA-256 digest of key, name and numbers stands at the end of a file.
        """
        key = (self._key + name).encode()
        path = folder / f"{hashlib.sha256(key).hexdigest()[:24]}.npy"
        with suppress(FileNotFoundError):
            content = path.read_bytes()
            numbers, digest = content[:-_DIGEST], content[-_DIGEST:]
            if digest == hashlib.sha256(key + numbers).digest():
                found: Floats = np.load(io.BytesIO(numbers), allow_pickle=False)
                return found
            warnings.warn(f"{path}: damaged, {name} is computed again", stacklevel=2)
        made, buffer = make(), io.BytesIO()
        np.save(buffer, made, allow_pickle=False)
        numbers = buffer.getvalue()
        with atomic(path) as temporary:
            temporary.write_bytes(numbers + hashlib.sha256(key + numbers).digest())
        return made


def without_each(gains: Floats) -> Iterator[Floats]:
    """Yield the gains (seas, shifts): all, without each shift, and without each of several seas."""
    yield gains
    for i in range(SHIFTS):
        yield np.delete(gains, i, axis=1)
    if len(gains) > 1:
        for i in range(len(gains)):
            yield np.delete(gains, i, axis=0)


def error_of(values: Floats) -> float:
    """Return the standard error of the first of values (1 + groups,), see `without_each`."""
    return math.sqrt(covariance_of(values[None])[0, 0])


def covariance_of(values: Floats) -> Floats:
    """Return the covariance (n, n) of the first of values (n, 1 + groups), see `without_each`.

    var = (m - 1) / m sum_i (v_i - mean v)^2 over the m shifts, and the same over the seas
    """
    total = np.zeros((len(values), len(values)))
    for groups in (values[:, 1 : 1 + SHIFTS], values[:, 1 + SHIFTS :]):
        m = groups.shape[1]
        if m > 1:
            off = groups - groups.mean(axis=1, keepdims=True)
            total += (m - 1) / m * off @ off.T
    return total
