"""Scintillation index against the shortest waves of a random sea."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Unpack

import numpy as np
from pydantic import Field

from meshtrace.checks import Positive, check_call
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Refused
from meshtrace.fading.distribution import scintillation_index
from meshtrace.fading.spectral import WITHIN, fading_band, scintillation_of_spectrum
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel
from meshtrace.models import Floats
from meshtrace.scenario import Scenario
from meshtrace.stored import Stored, Variable
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.refinement import descending
from meshtrace.studies.series import over_realizations

DEFAULT_BANDS = (4.0, 8.0, 12.0, 16.0, 24.0, 32.0, 64.0, 128.0)
"""Highest frequencies of a study [rad s-1]."""

_BOOTSTRAPS = 400  # tuned: time, or noise of the standard error of an index
_WITHIN_ONE = math.erf(math.sqrt(0.5))  # of normal errors within one standard error


@dataclass(frozen=True, eq=False, repr=False)
class FadingConvergence(
    Stored, kind="fading-convergence", title="meshtrace fading over the band of waves"
):
    """Scintillation index of unscattered light against the highest frequency of the sea.

    Attributes
    ----------
    omega_max : ndarray, shape (n,)
        Highest frequencies [rad s-1], rising.
    with_tilts, band_alone : ndarray, shape (n,)
        Closed form with random slopes for the waves beyond, and with nothing beyond.
    all_waves : float
        Closed form of all waves down to 1.3 mm.
    measured, measured_stderr : ndarray, shape (n,)
        Index with tilts over an ensemble, and its standard error; nan if not measured.
    tolerance : float
        Relative error of the index at `recommended`.
    recommended : float
        Smallest omega_max within the tolerance [rad s-1], nan if there is none.
    provenance : dict
        Versions, configuration and seeds.
    """

    omega_max: Annotated[Floats, Variable("omega_max")]
    with_tilts: Annotated[Floats, Variable("omega_max")]
    band_alone: Annotated[Floats, Variable("omega_max")]
    all_waves: float
    measured: Annotated[Floats, Variable("omega_max")]
    measured_stderr: Annotated[Floats, Variable("omega_max")]
    tolerance: float
    recommended: float
    provenance: dict[str, Any] = field(default_factory=dict)

    def _headline(self) -> str:
        percent = 100.0 * self.tolerance
        if math.isnan(self.recommended):
            return f"no omega_max with tilts within {percent:g} % of all waves"
        return (
            f"omega_max = {self.recommended:.3g} rad/s with tilts is within {percent:g} % of the "
            f"scintillation index of all waves, {self.all_waves:.3g}"
        )

    def summary(self) -> str:
        """Return the study as a table of text with a verdict."""
        lines = [
            f"{'omega_max [rad/s]':>18}{'band alone':>12}{'with tilts':>12}{'of all':>9}"
            f"{'measured':>12}{'stderr':>9}"
        ]
        closed = self.omega_max, self.band_alone, self.with_tilts
        table = zip(*closed, self.measured, self.measured_stderr, strict=True)
        for omega, alone, tilted, measured, stderr in table:
            line = f"{omega:>18g}{alone:>12.4g}{tilted:>12.4g}{tilted / self.all_waves:>9.1%}"
            lines.append(line if math.isnan(measured) else f"{line}{measured:>12.4g}{stderr:>9.2g}")
        lines.append(f"{'all waves':>18}{self.all_waves:>12.4g}{self.all_waves:>12.4g}")
        return "\n".join([*lines, self._headline()])


@check_call
def fading_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    omega_max: Sequence[float] = DEFAULT_BANDS,
    *,
    realizations: Annotated[int, Field(ge=0, le=1_000_000)] = 0,
    tolerance: Positive = WITHIN,
    **run: Unpack[StudyOptions],
) -> FadingConvergence:
    """Study how the scintillation index depends on the shortest waves of a random sea.

    Parameters
    ----------
    link : Link or Scenario
        A link on its axis, as for `fading.scintillation_of_spectrum`; or a scenario.
    surface : JonswapSea or SpectralSea, optional
        The sea. A spectrum with an omega^-5 tail is replaced by Elfouhaily's of the same wind and
        fetch (`short_waves` of the sea).
    omega_max : sequence of float
        At least four highest frequencies [rad s-1].
    realizations : int
        Seas of each band over which the index is measured as well; 0, the default, measures none.
    tolerance : float
        Relative error of the index at the recommended frequency.
    **run
        Options of the run, see `StudyOptions`.

    Returns
    -------
    FadingConvergence

    Raises
    ------
    Refused
        If an option is out of range, or there is no closed form for the link or the sea.

    Notes
    -----
    The band alone converges only once it holds centimetre waves: caustics of decimetre waves are
    blurred by nothing else. With tilts the index rises to that of all waves within a few per cent.
    """
    values = descending("omega_max", omega_max)[::-1]
    campaign = campaign_of(link, surface, "fading_study", run)
    link = campaign.link
    # the slopes of an omega^-5 tail have no limit: another spectrum stands for it
    sea = getattr(campaign.sea, "short_waves", campaign.sea)
    campaign = campaign._replace(surface=sea)
    # closed form down to the shortest capillary waves
    all_waves = scintillation_of_spectrum(link, sea)
    # with random slopes beyond each band, and without
    closed = [[scintillation_of_spectrum(link, sea, w, t) for w in values] for t in (True, False)]
    try:
        recommended = fading_band(link, sea, tolerance)
    except Refused:  # no band will do, or no random slopes stand for the waves beyond one
        recommended = math.nan
    measured = np.full((2, len(values)), math.nan)
    for i, limit in enumerate(values if realizations else ()):
        measured[:, i] = _measured(campaign, limit, realizations)
    tilted, alone = np.array(closed)
    recorded = {"omega_max": values, "realizations": realizations}
    return FadingConvergence(
        np.array(values), tilted, alone, all_waves, measured[0], measured[1], tolerance,
        recommended, campaign.provenance(of_study=recorded),
    )  # fmt: skip


def _measured(campaign: Campaign, omega_max: float, realizations: int) -> tuple[float, float]:
    """Return the scintillation index of unscattered light over an ensemble, and its error."""
    sea: Any = campaign.sea
    # the name of the link tells the bands apart in a store
    campaign = campaign.for_link(campaign.link, f"up to {omega_max!r} rad/s")
    campaign = campaign._replace(surface=sea.model_copy(update={"omega_max": omega_max}))
    gain = over_realizations(campaign, realizations).gain_ballistic
    index = scintillation_index(
        gain, confidence=_WITHIN_ONE, resamples=_BOOTSTRAPS, seed=campaign.run.seed
    )
    # half of an interval that reaches one standard error to either side
    return index.value, 0.5 * (index.high - index.low)
