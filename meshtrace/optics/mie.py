"""Mie scattering of spheres, and the phase function of a population of spheres.

The series coefficients come from miepython; this module adds the needs of a population: one
table of the scattering angle, averaged over sizes, that is computed once and kept on disk.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.resources
import json
import logging
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from types import ModuleType
from typing import IO, Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Positive, check_call
from meshtrace.errors import Described, Refused, refusing
from meshtrace.files import atomic, cache_directory, make_private
from meshtrace.models import Floats
from meshtrace.optics.phase import HistogramPhase
from meshtrace.parallel import environment

_LOG = logging.getLogger(__name__)
# Raise when the recipe of `population_table` changes: tables kept on disk are then left behind.
_FORMAT = 1
# Irrational steps of the angle inside a bin, in widths of the bin: the reciprocals of the golden
# ratio, from one set of angles to the next, and of the plastic number, from bin to bin.
_SIZE_STEP = 0.6180339887498949
_BIN_STEP = 0.7548776662466927
_ORDERS = 256  # orders n summed in one block. Tuned: it bounds the memory.


class Efficiencies(NamedTuple):
    """Mie efficiencies of spheres (cross-section / geometric cross-section) and mean cosine."""

    q_ext: Floats
    q_sca: Floats
    g: Floats


@dataclass(frozen=True, eq=False)
class MieTable:
    """Scattering-angle distribution of a population of spheres.

    Parameters
    ----------
    theta_edges : ndarray, shape (n,)
        Bin edges of the scattering angle [rad], increasing from 0 to pi.
    cdf : ndarray, shape (n,)
        Probability of an angle below each edge, from 0 to 1.
    q_sca : float
        Mean scattering efficiency, weighted by geometric cross-section.
    g : float
        Mean cosine, weighted by scattering cross-section, from the series (not the bins).
    closure : float
        Integral of the differential efficiency over all bins divided by `q_sca`, minus 1:
        the size of the averaging error before `cdf` was normalised.
    """

    theta_edges: Floats
    cdf: Floats
    q_sca: float
    g: float
    closure: float

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([self.q_sca, self.g, self.closure])):
            raise Refused("q_sca, g, closure", (self.q_sca, self.g, self.closure), "finite numbers")
        _ = self.phase  # refuses edges and probabilities that make no histogram
        # One table is shared by all who ask for it.
        self.theta_edges.setflags(write=False)
        self.cdf.setflags(write=False)

    @cached_property
    def phase(self) -> HistogramPhase:
        """Phase function of the population."""
        return HistogramPhase(theta_edges=self.theta_edges, cdf=self.cdf)


@lru_cache(maxsize=1)
def _miepython() -> ModuleType:
    """Import miepython with compiled functions, kept in the cache of kernels."""
    from meshtrace.kernels.jit import foreign_kernels

    # miepython reads the variable when it is imported
    with environment({"MIEPYTHON_USE_JIT": "1"}), foreign_kernels():
        return importlib.import_module("miepython")


Sizes = Annotated[ArrayLike, Field(gt=0.0)]
"""Size parameters of spheres."""


@check_call
def efficiencies(m: complex, x: Sizes) -> Efficiencies:
    """Return extinction and scattering efficiency and mean cosine of spheres.

    Q_ext = 2/x^2 sum (2n+1) Re(a_n + b_n)

    Parameters
    ----------
    m : complex
        Refractive index of the sphere relative to its surroundings, n - i k.
    x : array_like
        Size parameter 2 pi r n_medium / wavelength (vacuum wavelength).

    Returns
    -------
    Efficiencies
        `q_ext`, `q_sca`, `g`, each of the shape of `x`.

    Raises
    ------
    Refused
        If a size parameter is not positive and finite.

    Notes
    -----
    Tested for air in water (m = 0.75) from x = 10 to x = 17780.

    References
    ----------
    Bohren and Huffman (1983), Absorption and Scattering of Light by Small Particles, ch. 4.
    Wiscombe (1979), NCAR/TN-140+STR.

    Examples
    --------
    >>> q = efficiencies(0.75, 10.0)
    >>> round(float(q.q_sca), 6), round(float(q.g), 6)
    (2.232265, 0.896473)
    """
    sizes = np.asarray(x)
    q_ext, q_sca, _, g = _miepython().efficiencies_mx(m, sizes.ravel())
    return Efficiencies(*(np.asarray(q).reshape(sizes.shape)[()] for q in (q_ext, q_sca, g)))


@check_call
def phase_intensity(
    m: complex, x: Positive, cos_theta: Annotated[ArrayLike, Field(ge=-1.0, le=1.0)]
) -> Floats:
    """Return the unpolarised scattered intensity of one sphere.

    i(theta) = (|S1|^2 + |S2|^2) / 2,   integral of i over solid angle = pi x^2 Q_sca

    Parameters
    ----------
    m : complex
        Refractive index of the sphere relative to its surroundings, n - i k.
    x : float
        Size parameter 2 pi r n_medium / wavelength.
    cos_theta : array_like
        Cosine of the scattering angle.

    Returns
    -------
    ndarray
        Intensity i, of the shape of `cos_theta`.

    Raises
    ------
    Refused
        If `x` is not positive or `cos_theta` leaves [-1, 1].

    Notes
    -----
    The amplitudes S1, S2 have Wiscombe's norm, that of van de Hulst and of Bohren and Huffman's
    book (miepython's norm "bohren" is twice as large). The phase function is
    i / (pi x^2 Q_sca) [1/sr].

    References
    ----------
    Wiscombe (1980), Applied Optics 19, 1505, doi:10.1364/AO.19.001505.

    Examples
    --------
    Its integral over solid angle is pi x^2 Q_sca:

    >>> node, weight = np.polynomial.legendre.leggauss(60)
    >>> round(float(2.0 * phase_intensity(0.75, 10.0, node) @ weight / 10.0**2), 6)
    2.232265
    """
    cosine = np.asarray(cos_theta)
    intensity = _miepython().i_unpolarized(m, x, cosine.ravel(), norm="wiscombe")
    return np.asarray(intensity).reshape(cosine.shape)[()]


def angular_edges() -> Floats:
    """Return the 2501 bin edges of the scattering angle [rad].

    0, then 750 edges in geometric progression from 0.001 to 5 deg, where diffraction of bubbles
    up to 1 mm falls off, then steps of 0.1 deg to 180 deg. 90 deg is an edge, so that the
    backscatter fraction is exact.
    """
    forward = np.geomspace(1e-3, 5.0, 750)
    # 5.1 ... 180.0 deg
    return np.deg2rad(np.concatenate(([0.0], forward, np.arange(51, 1801) / 10.0)))


def _angular_blocks(cosine: Floats, orders: int) -> Iterator[tuple[int, Floats, Floats]]:
    """Yield blocks of the angular functions, scaled for the sums of S1 and S2.

    Each block is (start, pi, tau): row i holds (2n+1)/(n(n+1)) pi_n and tau_n of the order
    n = start + 1 + i, shape (orders of the block, angles).
    """
    # Upward recurrences (Bohren and Huffman, eq. 4.47), mu = cos(theta), pi_0 = 0, pi_1 = 1:
    # tau_n = n mu pi_n - (n+1) pi_(n-1),  pi_(n+1) = ((2n+1) mu pi_n - (n+1) pi_(n-1)) / n
    previous, current = np.zeros_like(cosine), np.ones_like(cosine)
    for start in range(0, orders, _ORDERS):
        count = min(_ORDERS, orders - start)
        pi, tau = np.empty((2, count, cosine.size))
        for row, n in enumerate(range(start + 1, start + count + 1)):
            scale = (2 * n + 1) / (n * (n + 1))
            mu_pi = cosine * current
            pi[row] = scale * current
            tau[row] = (scale * n) * mu_pi - (scale * (n + 1)) * previous
            previous, current = current, ((2 * n + 1) * mu_pi - (n + 1) * previous) / n
        yield start, pi, tau


def _intensities(m: complex, x: Floats, cosine: Floats) -> Floats:
    """Return `phase_intensity` of many spheres, shape (angles, spheres), for x in falling order.

    The spheres share their angles, so pi_n and tau_n are summed with the coefficients of all of
    them by matrix products: S1 + S2 = sum (a+b)(pi+tau), S1 - S2 = sum (a-b)(pi-tau).
    """
    series = [_miepython().coefficients(m, size) for size in x]
    orders = np.array([pair.shape[1] for pair in series])
    # S1 + S2 and S1 - S2, two columns (real, imaginary) for each sphere
    plus, minus = np.zeros((2, cosine.size, 2 * x.size))
    for start, pi, tau in _angular_blocks(cosine, int(orders[0])):
        # larger spheres have more orders: those with terms in this block come first
        spheres = int(np.count_nonzero(orders > start))
        sums, differences = np.zeros((2, len(pi), spheres), dtype=np.complex128)
        for column in range(spheres):
            a, b = series[column][:, start : start + len(pi)]
            sums[: a.size, column] = a + b
            differences[: a.size, column] = a - b
        # Real and imaginary parts side by side keep the products real: half the work.
        plus[:, : 2 * spheres] += (pi + tau).T @ sums.view(np.float64)
        minus[:, : 2 * spheres] += (pi - tau).T @ differences.view(np.float64)
    # |S1|^2 + |S2|^2 = (|S1 + S2|^2 + |S1 - S2|^2) / 2, and i is half of it
    square = plus**2 + minus**2
    return (square[:, ::2] + square[:, 1::2]) / 4.0


@check_call
def population_table(
    m: complex,
    x: Sizes,
    theta_edges: ArrayLike | None = None,
    rotations: Annotated[int, Field(ge=1)] = 32,
) -> MieTable:
    """Return the scattering-angle table of a population of spheres.

    P_j = mean_k [ i_k(theta_jk) / x_k^2 ] (Omega_j / pi) / Qbar,   Qbar = mean_k Q_sca(x_k)

    Parameters
    ----------
    m : complex
        Refractive index of the spheres relative to their surroundings.
    x : array_like, shape (k,)
        Size parameters, each of which stands for the same share of the population's geometric
        cross-section.
    theta_edges : array_like, optional
        Bin edges [rad] from 0 to pi; by default `angular_edges()`.
    rotations : int
        Number of node sets, see Notes.

    Returns
    -------
    MieTable

    Raises
    ------
    Refused
        If a size parameter is not positive, or `rotations` is below 1.

    Notes
    -----
    A large sphere's intensity oscillates faster than any affordable bin. Each bin is therefore
    evaluated at one angle per sphere, and that angle rotates through the bin (uniformly in
    cos theta) from sphere to sphere, so that size and angle are averaged together. The angle
    sets are `rotations` in number; spheres that share a set are summed by matrix products.

    For 6144 bubbles between 10 um and 1 mm tables from different node sets agree within 3e-5
    in the CDF and 3e-5 in `closure`; it takes some 10 s on two cores.
    """
    # in falling order the spheres that still have terms are the first ones of every block
    sizes = np.sort(np.ravel(x))[::-1]
    edges = angular_edges() if theta_edges is None else np.array(theta_edges, dtype=np.float64)
    if edges.ndim != 1 or edges.size < 2 or not (np.diff(edges) > 0.0).all():
        raise Refused("theta_edges", edges, "increasing angles (n,) from 0 to pi")
    # in s = sin^2(theta / 2), where dOmega = 4 pi ds
    s_edges = np.sin(edges / 2.0) ** 2
    width = np.diff(s_edges)
    offset = _BIN_STEP * np.arange(width.size)
    mass = np.zeros(width.size)
    # every `rotations`-th sphere shares a set of angles; more sets than spheres would be empty
    for turn in range(min(rotations, sizes.size)):
        # steps of irrational numbers fill a bin evenly, whatever the number of sets
        nodes = s_edges[:-1] + width * ((offset + _SIZE_STEP * turn) % 1.0)
        chosen = sizes[turn::rotations]
        mass += (_intensities(m, chosen, 1.0 - 2.0 * nodes) / chosen**2).sum(axis=1)
    # A bin's solid angle is 4 pi width, and dQ_sca/dOmega is i / (pi x^2).
    cdf = np.concatenate(([0.0], np.cumsum(4.0 * width * mass / sizes.size)))
    _, q_sca, g = efficiencies(m, sizes)
    mean = float(q_sca.mean())
    return MieTable(
        theta_edges=edges,
        cdf=cdf / cdf[-1],
        q_sca=mean,
        g=float((q_sca * g).mean()) / mean,
        closure=float(cdf[-1]) / mean - 1.0,
    )


@check_call
def cached_table(
    stem: str, inputs: Mapping[str, int | float], compute: Callable[[], MieTable]
) -> MieTable:
    """Return the table of these inputs: shipped, from the user's cache, or computed and stored.

    Parameters
    ----------
    stem : str
        Beginning of the file's name; a hash of `inputs` follows.
    inputs : mapping of str to float
        Everything the table depends on.
    compute : callable
        Makes the table if no file has it.

    Returns
    -------
    MieTable

    Notes
    -----
    Files are replaced atomically (`files.atomic`), so that parallel runs see whole files. A
    damaged file is replaced with a warning. If the cache cannot be written, a warning is issued and
    the table is computed again next time.
    """
    if not re.fullmatch(r"[\w.-]{1,100}", stem):
        raise Refused("stem", stem, "letters, digits, points and hyphens, at most 100")
    # The inputs are stored in the file, too, and compared: its name has only a part of the hash.
    text = json.dumps(dict(inputs) | {"format": _FORMAT}, sort_keys=True)
    name = f"{stem}-{hashlib.sha256(text.encode()).hexdigest()[:16]}.npz"
    shipped = importlib.resources.files("meshtrace.optics").joinpath("data", name)
    cached = cache_directory() / name
    for file in (shipped, cached):
        if file.is_file():
            try:
                with file.open("rb") as stream:
                    return _read(stream, text)
            except Exception as why:  # numpy and zipfile raise any exception
                warnings.warn(f"{file}: damaged, computed again ({why})", stacklevel=2)
    _LOG.info("computing the Mie table %s (about 10 s, once)", name)
    allowed = "a function without arguments that returns a MieTable"
    with refusing("compute", allowed):
        table = compute()
    if not isinstance(table, MieTable):
        raise Refused("compute", Described(f"a {type(table).__name__}"), allowed)
    try:
        make_private(cached.parent)
        with atomic(cached) as temporary, temporary.open("wb") as stream:
            np.savez(stream, inputs=np.array(text), **asdict(table))
    except OSError as why:
        warnings.warn(f"{cached}: not kept ({why})", stacklevel=2)
    return table


def _read(stream: IO[bytes], text: str) -> MieTable:
    # no pickles: a table that another user may have written runs nothing
    with np.load(stream, allow_pickle=False) as data:
        if str(data["inputs"]) != text:
            raise ValueError("made from other inputs")
        numbers = (float(data[name]) for name in ("q_sca", "g", "closure"))
        return MieTable(data["theta_edges"], data["cdf"], *numbers)
