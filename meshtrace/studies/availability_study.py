"""Availability of a link over uncertain inputs: share of working time, and range."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
from pydantic import Field
from scipy import stats

from meshtrace.checks import ErrorRate, Positive, Probability, check_call
from meshtrace.comms.ook import OokLink, Preset
from meshtrace.engine.setup.options import Case, StudyOptions
from meshtrace.errors import Described, Refused
from meshtrace.link import Link
from meshtrace.parallel import held
from meshtrace.scenario import Scenario
from meshtrace.studies.availability_result import Availability
from meshtrace.studies.availability_runs import StateRuns, axes_of, key_in_file
from meshtrace.studies.availability_shares import ShareSurfaces
from meshtrace.studies.background import electronics_of
from meshtrace.studies.base import base_scenario, plain_base
from meshtrace.studies.campaign import DEFAULT_CHAINS, campaign_of, case_options
from meshtrace.studies.inputs import read_inputs
from meshtrace.studies.keys import Bounds
from meshtrace.studies.neighbours import depth_key

PRIOR: Mapping[str, Any] = {
    "wind_speed": {"distribution": "weibull_min", "c": 2.2, "scale": 7.9, "clip": [1.0, 15.0]},
    "water.chlorophyll": {"distribution": "lognorm", "s": 0.7, "scale": 0.3, "clip": [0.03, 3.0]},
}
"""Inputs by default: wind over the open sea [m s-1], and chlorophyll [mg m-3] of most of it."""

_SPREAD = 0.6, 1.4  # bounds of the depth over that at which median inputs close the link
_FAR = 2.0  # ratio of that depth to the one of the link from which the bounds are about the latter


@check_call
def availability(
    link: Link | Scenario,
    inputs: Mapping[str, Any] | str | Path | None = None,
    *,
    threshold: Positive | None = None,
    ook: OokLink | Preset = "physical",
    bit_rate: float | None = None,
    limit: ErrorRate = 1e-3,
    outage: Probability = 0.01,
    bounds: Bounds | None = None,
    target: Probability = 0.9,
    runs: Annotated[int, Field(ge=8, le=100_000)] = 32,
    realizations: Annotated[int, Field(ge=4, le=100_000)] = 16,
    **run: Unpack[StudyOptions],
) -> Availability:
    r"""Return the share of the time that a link works, over uncertain inputs.

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver.
    inputs : mapping or path, optional
        Inputs by their keys in a link file, or a TOML file of them: each a frozen law of
        `scipy.stats`, samples, or a table, see Notes. By default the wind and the chlorophyll of
        the open sea, `studies.availability_study.PRIOR`.
    threshold : float, optional
        Gain of a working link; by default that which the transmission needs for `limit`.
    ook : OokLink or preset
        Transmission, by default that of the scenario.
    bit_rate : float, optional
        Bit rate R_b [bit s-1], by default that of the transmission.
    limit : float
        Largest bit error rate of a working link.
    outage : float
        Wanted outage by fades: the share of time in a state that may miss the need.
    bounds : mapping of one str to (low, high), optional
        Key, with bounds, of which the range is asked; by default the depth, about that at
        which median inputs close the link, or about that of the link where they differ twofold.
        Empty for no range.
    target : float
        Share of the year at the range.
    runs : int
        Runs to which the surfaces are fitted.
    realizations : int
        Seas of the fading of each run.
    **run
        Options of the run, see `StudyOptions`: 2048 chains by default over the seas, eight times as
        many for the mean gain; progress by run. The store keeps the runs, from which other
        thresholds follow at once.

    Returns
    -------
    Availability

    Raises
    ------
    Refused
        If an input is no law and no samples, a key or a value is not allowed, or the surface of
        the gain is wrong by a factor of two where a run is left out.

    Notes
    -----
    The table of an input has a law by its name in `scipy.stats` and its parameters, each a number
    or twelve by month (``{distribution = "weibull_min", c = 2.2, scale = 7.9}``), or ``samples``,
    or a ``file`` with the ``variable`` of a netCDF file or a column of a CSV file and its
    ``time``; ``clip = [low, high]`` limits the values. Samples at times of all months are taken by
    month. Inputs of one file are drawn at the same times; all others are independent.

    Runs at Sobol points between the 0.2 and 99.8 % quantiles give the mean gain g over a sea whose
    waves are random slopes, and the variance s^2 of ln h over seas with all waves that fade.
    Response surfaces of ln g and ln s^2, Gaussian processes with noise, give in each state x of the
    inputs

    .. math:: P(h \ge h_0 \mid x) = 1 - F((\ln h_0 - \mathrm{E} \ln h) / s)

    with F the gamma-gamma law of equal shapes, `fading.laws.probability_in_log`. The share is its
    mean over 4096 states or more. Its standard error is that of the surfaces, weighted by the
    derivative of the share, and of the states; that of finite samples is not included.

    Sobol indices (`scipy.stats.sobol_indices`) take all inputs for independent.

    Examples
    --------
    >>> import meshtrace as mt
    >>> a = mt.studies.availability(mt.Link(), {"water.a": {"samples": [0.1, 0.2, 0.4]}},
    ...                             threshold=1e-5, bounds={}, runs=8, realizations=4, photons=64)
    >>> f"{a.year.mean_share:.2f}"
    '0.67'
    """
    run.setdefault("photons", DEFAULT_CHAINS)
    campaign = campaign_of(link, None, "availability", run, several=False)
    campaign.require_chains()
    if len(campaign.link.receivers) != 1:
        n = Described(f"{len(campaign.link.receivers)} apertures")
        raise Refused("receiver", n, "one aperture")
    known = read_inputs(PRIOR if inputs is None else inputs)
    scenario = base_scenario(link, None)
    if threshold is None:
        electronics = electronics_of(campaign, ook, bit_rate)
        scenario = scenario.model_copy(update={"detector": electronics})
    # with the choice of waves, which a campaign fixes for one wind: each run has its own
    case = Case(scenario.link, scenario.surface, scenario.run, scenario.meshing)
    meshing = case.with_options(**case_options(run)).meshing
    config = plain_base(scenario, (key_in_file(item.name) for item in known))
    study = StateRuns(
        config, campaign.run.photons, meshing, campaign.run.seed, realizations, threshold, limit
    )
    closing: float | None = None
    if bounds is None:
        bounds = {}
        depth = scenario.link.depth
        if not math.isnan(depth):
            closing = study.closing_depth(scenario.link, known)
            # a range far from the link is only named: deeper links take longer
            middle = closing if depth < _FAR * closing < _FAR**2 * depth else depth
            low, high = (factor * middle for factor in _SPREAD)
            bounds = {depth_key(scenario.link): (min(low, depth), max(high, depth))}
    axes = axes_of(known, bounds)
    names = [axis.name for axis in axes]
    value = study.value(names[-1]) if bounds else math.nan
    sobol = stats.qmc.Sobol(len(axes), rng=campaign.run.seed)
    places = sobol.random_base2(math.ceil(math.log2(runs)))[:runs]
    values = np.transpose([axis.value(places[:, k]) for k, axis in enumerate(axes)])
    study.check(axes, values[0].tolist())
    steps = [(i, *row) for i, row in enumerate(values.tolist())]
    identity = {"runs": study.identity() | {"names": names}}
    each = campaign.evaluate(
        lambda: partial(study.measure, names), steps, "runs", identity, lambda step: (4,), "runs"
    )
    numbers = np.array(list(each))
    if threshold is not None:
        numbers[:, 3] = threshold
    spans = {item.name: item.ppf([0.0, 0.5, 1.0]).tolist() for item in known}
    # digits of the surfaces do not depend on the threads of BLAS
    answer = held(ShareSurfaces)(study, known, axes, values, numbers, (outage, target), value)
    return held(answer.result)(
        campaign.provenance(of_study={"inputs": spans, "closing_depth": closing})
    )
