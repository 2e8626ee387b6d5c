"""W2A-1, a reference case of light that crosses a wavy sea: inputs, gains and checks.

The inputs, values, errors and rules of the score are in `w2a1.json`; `examples/w2a1` has the same
file with a script that scores the results of any program.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace import DomainWarning, GainResult, SurfaceModel, TriangleMesh, simulate
from meshtrace.link import Led, Link, Physics, Receiver
from meshtrace.mesh import WaveSum
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea
from meshtrace.validation import Check
from meshtrace.validation.closed_forms import exact

CHAINS, QUICK_CHAINS, SERIES_CHAINS = 16_384, 4096, 2048
"""Chains of a total, and of each time of a series."""

_HALF_WIDTH, _SPACING, _SERIES_SPACING = 6.0, 0.05, 0.1  # [m], of the meshes
_SERIES = 5e-3  # of an unscattered gain of a series
_SPREAD = 0.01  # of a relative standard deviation
_LISTED = 1e-8  # of the waves, printed with nine digits


STEPS = 22
"""Cases and series."""


@cache
def reference() -> dict[str, Any]:
    """Return the reference case as plain data."""
    data: dict[str, Any] = json.loads(Path(__file__).with_name("w2a1.json").read_text("utf-8"))
    return data


def surface(name: str) -> SurfaceModel:
    """Return a surface of the case: "flat", "sinusoid", "jonswap5" or "jonswap13"."""
    if name == "flat":
        return FlatSea()
    if name == "sinusoid":
        return SinusoidalSea(amplitude=0.05, wavelength=3.0)
    return JonswapSea(wind_speed=float(name.removeprefix("jonswap")), waves="paper", seed=7)


def link(variant: str) -> Link:
    """Return the link of a case by the part of its name after the slash, such as "r5cm"."""
    inputs = reference()["variants"][variant]
    receiver = Receiver(
        position=(inputs["x"], 0.0), radius=inputs["radius"], fov_deg=inputs["fov_deg"]
    )
    transmitter = Led(depth=inputs["depth"])
    # the case takes the mesh as the sea, without slopes below its spacing
    return Link(transmitter=transmitter, receiver=receiver, physics=Physics(unresolved="none"))


def gain(case: str, chains: int = CHAINS) -> GainResult:
    """Return the gains of a case, such as "jonswap5/r25cm", by forced detection."""
    sea, variant = case.split("/")
    return _gain_over(surface(sea).mesh(0.0, _HALF_WIDTH, _SPACING), variant, chains)


def _gain_over(mesh: TriangleMesh, variant: str, chains: int) -> GainResult:
    with warnings.catch_warnings():
        # the case prescribes the mesh, and tolerances that allow for it
        warnings.simplefilter("ignore", DomainWarning)
        return simulate(link(variant), mesh, photons=chains, seed=1)


def series(sea: str, chains: int = SERIES_CHAINS) -> list[GainResult]:
    """Return the gains at the times of a series, with chains of one seed."""
    row = reference()["series_frozen_phases"][f"{sea}/series"]
    times = row["t0"] + row["dt"] * np.arange(row["n"])
    moving = surface(sea)
    meshes = (moving.mesh(float(t), _HALF_WIDTH, _SERIES_SPACING) for t in times)
    return [_gain_over(mesh, "r5cm", chains) for mesh in meshes]


def checks(quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Check]:
    """Yield the comparison of this package with every number of the case.

    Parameters
    ----------
    quick : bool
        A quarter of the chains.
    progress : callable, optional
        Called with the name of each case before it runs.
    """
    source = "W2A-1"
    yield from _wave_checks()
    for name, row in reference()["cases"].items():
        if progress is not None:
            progress(name)
        computed = gain(name, QUICK_CHAINS if quick else CHAINS)
        tolerance = row["unscattered_tol_rel"]
        assert computed.gain_ballistic is not None
        unscattered, stderr = float(computed.gain_ballistic), float(computed.gain_stderr)
        yield exact(f"{name} unscattered", source, row["unscattered"], unscattered, tolerance)
        # a second estimator or program has confirmed the total
        confirmed = any(key.startswith("total_independent") for key in row)
        status = source if confirmed else f"{source}, single code"
        total = row["total"], float(computed.gain), stderr, row["total_stderr"]
        yield Check(f"{name} total", status, *total)
    for name, row in reference()["series_frozen_phases"].items():
        if progress is not None:
            progress(name)
        yield from _series_checks(name, row)


def _series_checks(name: str, row: dict[str, Any]) -> Iterator[Check]:
    """Yield the checks of a series: its worst time, and its spread."""
    computed = series(name.split("/")[0])
    unscattered, total = (
        np.array([float(getattr(g, k)) for g in computed]) for k in ("gain_ballistic", "gain")
    )
    expected = np.array(row["unscattered_gain"])
    # one check for all times: the case asks that each be within the tolerance
    worst = int(np.abs(unscattered / expected - 1.0).argmax())
    what = f"{name} unscattered, worst of {len(expected)}"
    yield exact(what, "W2A-1", expected[worst], unscattered[worst], _SERIES)
    spread = float(total.std(ddof=1) / total.mean())
    yield exact(f"{name} spread of total", "W2A-1", row["total_rel_std"], spread, _SPREAD)


def _wave_checks() -> Iterator[Check]:
    """Yield the comparison of the waves of the seas with the listed ones."""
    yield _largest_difference("jonswap5", _waves(5), reference()["jonswap5_components"]["rows"])
    waves, listed = _waves(13), reference()["jonswap13_check"]
    variance = 0.5 * float(np.square(waves[:, 0]).sum())
    expected = listed["sum_amplitude_squared_half"]
    yield exact("jonswap13 waves, variance", "W2A-1", expected, variance, _LISTED)
    yield _largest_difference("jonswap13", waves[[0, -1]], [listed["first"], listed["last"]])


def _waves(wind_speed: int) -> NDArray[np.float64]:
    """Return the waves of a random sea as rows of five properties, the last being the phase."""
    sea = surface(f"jonswap{wind_speed}")
    assert isinstance(sea, WaveSum)
    return np.array(sea.components[:5]).T


def _largest_difference(name: str, waves: NDArray[np.float64], listed: list[list[float]]) -> Check:
    difference = waves - np.array(listed)
    # phases are equal up to full turns
    largest = max(np.abs(difference[:, :4]).max(), np.abs(np.sin(0.5 * difference[:, 4])).max())
    return Check(f"{name} waves, largest difference", "W2A-1", 0.0, float(largest), 0.0, _LISTED)


def score(checks: Iterable[Check]) -> int:
    """Return the number of checks within the rules of the case: |z| <= 3, or the tolerance."""
    return sum(abs(check.z) <= (3.0 if check.stderr else 1.0) for check in checks)
