"""All checks, and the photons of each family."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from typing import NamedTuple

from meshtrace.errors import DomainWarning
from meshtrace.validation.check import Check
from meshtrace.validation.estimators import estimator_checks
from meshtrace.validation.flat_sea import flat_sea_checks
from meshtrace.validation.mobley import mobley_checks
from meshtrace.validation.optics import optics_checks
from meshtrace.validation.receiver import receiver_checks
from meshtrace.validation.slabs import slab_checks


class Family(NamedTuple):
    """Group of checks, with their numbers of photons."""

    checks: Callable[[int], Iterable[Check]]
    photons: int
    quick_photons: int


SUITE = {
    "optics and waves": Family(optics_checks, 4_000_000, 500_000),
    "receiver": Family(receiver_checks, 0, 0),
    "still water": Family(flat_sea_checks, 20_000_000, 1_000_000),
    "slabs": Family(slab_checks, 20_000_000, 1_000_000),
    "canonical problems": Family(mobley_checks, 5_000_000, 250_000),
    "analog against forced": Family(estimator_checks, 15_000_000, 1_000_000),
}
"""Families of checks by name, in the order in which they run."""


def validate(
    quick: bool = False, progress: Callable[[str], None] | None = None
) -> tuple[Check, ...]:
    """Run every check against closed forms, published tables and the other estimator.

    Parameters
    ----------
    quick : bool
        A twentieth of the photons: larger standard errors, the same checks.
    progress : callable, optional
        Called with the name of each family of checks before it runs.

    Returns
    -------
    tuple of Check
        Seeds are fixed: results on one machine are reproducible.

    Examples
    --------
    >>> checks = validate(quick=True)  # doctest: +SKIP
    >>> max(abs(check.z) for check in checks) < 4.0  # doctest: +SKIP
    True
    """
    found: list[Check] = []
    for name, family in SUITE.items():
        if progress is not None:
            progress(name)
        with warnings.catch_warnings():
            # slabs are infinite, meshes are not: the light that wanders off is negligible
            warnings.filterwarnings("ignore", "(?s).*left the meshed surface", DomainWarning)
            found += family.checks(family.quick_photons if quick else family.photons)
    return tuple(found)
