"""Response of the channel over the seas of a study, in delay and wavelength."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

from meshtrace.comms.ook import OokLink
from meshtrace.comms.response import SHORT, ChannelResponse, spread_of
from meshtrace.comms.spectra import Curve, lit_band
from meshtrace.engine.forced import MANY_SEAS, TypicalSea
from meshtrace.engine.outcome import FewSamplesWarning
from meshtrace.engine.parts import Light
from meshtrace.engine.setup.meshing import surface_config
from meshtrace.engine.setup.options import Analog, Arrivals
from meshtrace.engine.simulate import simulate
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.parallel import held, ordered_map
from meshtrace.results.impulse import SPEED_OF_LIGHT, ImpulseResponse, response_of
from meshtrace.results.tallies import ArrivalTally, error_of_groups
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.keys import Variant
from meshtrace.studies.store import digest_of

MOST_SEAS = 4
"""Seas of the mean response."""

_COLOURS = 17  # over the spectrum of a lamp
_CLEAR = 1e-3  # change of the optical thickness over them that counts
_IDLE = 0.1  # of the shortest spread that counts: responses of neighbours are shorter than it
_BEYOND = 4.0  # times the longest delay of a link, up to which its neighbours have pulses
_PARTS = 3  # of the chains; the response of one of them gives the error of that of all


MeanResponse = tuple[ChannelResponse, float, float]
"""Response of the channel, its rms spread [s], and the standard error of that."""


@held
def mean_responses(campaign: Campaign, seas: int) -> list[MeanResponse | None]:
    """Return the mean response of the only link of a campaign, or one for each wavelength.

    The mean over the first surfaces of an ensemble, at most four, aligned at first light; None
    without light. An aircraft does not tilt the receiver. Each has the gain of its own wavelength.
    """
    links = list(campaign.links.values())
    steps = campaign.surfaces(min(seas, MOST_SEAS))
    numbers, threads = range(len(steps.labels)), campaign.threads
    meshes = list(ordered_map(lambda i: campaign.mesh(links, *steps.surface(i)), numbers, threads))
    by_sea, means = ordered_map(_arrivals_over(campaign, meshes), meshes, threads), []
    for tallies in zip(*by_sea, strict=True):
        responses = [response_of(tally) for tally in tallies if tally.weight.any()]
        means.append(_mean(responses) if responses else None)
    return means


def _arrivals_over(
    campaign: Campaign, meshes: list[TriangleMesh]
) -> Callable[[TriangleMesh], Sequence[ArrivalTally]]:
    """Return a function that computes the arrivals over a mesh at each wavelength."""
    links, run, normals = list(campaign.links.values()), campaign.run, campaign.meshing.normals
    if isinstance(run.estimator, Analog):

        def arrivals(mesh: TriangleMesh) -> Sequence[ArrivalTally]:
            with warnings.catch_warnings(action="ignore", category=FewSamplesWarning):
                result = simulate(
                    links[0], mesh, normals=normals, threads=1, record=[Arrivals()],
                    estimator=run.estimator, photons=run.photons, seed=run.seed,
                )  # fmt: skip
            assert result.arrivals is not None
            return [result.arrivals]

        return arrivals
    sea = TypicalSea.of_meshes(meshes, MANY_SEAS)
    links = links if campaign.spectral else links[:1]
    (chains,) = campaign.detections(links, sea, campaign.threads)
    return lambda mesh: [gains.table[0] for gains in chains.at_wavelengths(mesh, record=True)]


def over_colours(
    seen: MeanResponse | None, ook: OokLink, campaign: Campaign, seas: int
) -> MeanResponse | None:
    """Return a response with the gain over the spectrum of the lamp, see `gain_spectrum`."""
    if seen is None:
        return None
    response, spread, stderr = seen
    return response.replace(gain_spectrum=gain_spectrum(ook, campaign, seas)), spread, stderr


def through_channel(ook: OokLink, campaign: Campaign, seas: int) -> OokLink:
    """Add the channel response to a transmission that has none."""
    if ook.response is not None:
        return ook
    (seen,) = mean_responses(campaign, seas)
    seen = over_colours(seen, ook, campaign, seas)
    return ook if seen is None else ook.replace(response=seen[0])


def gain_spectrum(ook: OokLink, campaign: Campaign, seas: int) -> Curve | None:
    """Return the gain over the wavelengths of the lamp that pass the filter, from common paths.

    None where the transmission has its own, and where that at the wavelength of the link stands for
    all: one wavelength, a water without spectrum, or an optical thickness of the water above the
    deepest end that changes by less than a thousandth.
    """
    link, spectrum = campaign.link, campaign.link.water.spectrum
    if ook.gain_spectrum is not None or spectrum is None:
        return None
    low, high = lit_band(ook)
    here = link.transmitters[0].wavelength_nm
    nodes = np.union1d(np.linspace(low, high, _COLOURS), here)
    # beyond the data of the water its nearest value stands
    known = np.unique(np.clip(nodes, *spectrum.limits_nm)).tolist()
    links = {f"{nm!r} nm": link.at_wavelength(nm) for nm in known}
    # optical thickness of a stratified water, by 64 steps of depth
    depth = np.linspace(0.0, max(-item.center[2] for _, item in link.items()), 65)
    thickness = [
        depth[-1] * np.mean(np.add(*spectral_link.water.profile(depth)))
        for spectral_link in links.values()
    ]
    if np.ptp(thickness) < _CLEAR:
        return None
    whole = campaign.alone._replace(links=links, spectral=True)
    gains = whole.gains(campaign.surfaces(min(seas, MOST_SEAS)))[0]
    # the gain falls as exp(-c z): smooth in its logarithm
    logs = np.log(np.maximum(gains.reshape(len(known), -1).mean(axis=1), 1e-300))
    fine = np.union1d(np.linspace(low, high, 16 * _COLOURS), here)
    value = np.exp(PchipInterpolator(known, logs)(np.clip(fine, known[0], known[-1])))
    return Curve(wavelength_nm=fine.tolist(), value=value.tolist())


def _mean(responses: list[ImpulseResponse]) -> MeanResponse:
    """Return the mean of responses; the standard error holds chains and seas."""
    arrivals = ((response.delay, response.weight, response.angle) for response in responses)
    delay, weight, angle = map(np.concatenate, zip(*arrivals, strict=True))
    # chains are common to the seas: their error does not fall with the number of seas
    error = float(np.mean([response.rms_delay_spread_stderr for response in responses]))
    if len(responses) > 1:
        spreads = np.array([response.rms_delay_spread for response in responses])
        error = math.hypot(error, float(error_of_groups(spreads)))
    mean = ChannelResponse.from_arrivals(delay, weight, angle)
    return mean, spread_of(delay, weight), error


def light_response(
    link: Link, lights: Sequence[Light], pulses: Sequence[float] | None = None
) -> ChannelResponse | None:
    """Return the mean impulse response of the light of several seas, aligned at first light.

    None without light. `pulses` are the delays of its pulses [s], by default its own.
    """
    columns = []
    for part in lights:
        nonzero = part.weight > 0.0
        if nonzero.any():
            way = link.water.n * part.water[nonzero] + link.n_air * part.air[nonzero]
            columns.append(
                ((way - way.min()) / SPEED_OF_LIGHT, part.weight[nonzero], part.angle[nonzero])
            )
    if not columns:
        return None
    delay, weight, angle = map(np.concatenate, zip(*columns, strict=True))
    return ChannelResponse.from_arrivals(delay, weight, angle, pulses or 64)


class Responses:
    """Transmissions of links near one link, each with the response of its chains.

    Parameters
    ----------
    light_of : callable
        Returns the light of a variant over each of some seas.
    base : Variant
        The one link.
    aligned : bool
        Whether the pulses of all have the delays of those of the base: differences between links
        that differ by little then follow their light without steps.

    Notes
    -----
    All responses are instantaneous where the rms delay spread of the base is less than a
    ten-thousandth of a bit and no filter shifts with the angle of arrival.
    """

    def __init__(
        self,
        light_of: Callable[[Variant], list[Light]],
        base: Variant,
        aligned: bool = False,
    ) -> None:
        self._light_of, self._aligned = light_of, aligned
        self._pulses: tuple[float, ...] | None = None
        self._responses: dict[str, tuple[ChannelResponse | None, ...]] = {}
        self._base = base

    def count(self, at: Variant) -> bool:
        """Return whether the transmission of a variant depends on the response of its link."""
        ook = at.detector
        if ook is None or ook.response is not None:
            return False
        seen = self._of(self._base)[0]
        if seen is None:
            return False
        shifted = ook.spectral and ook.optics.filter_index is not None
        return shifted or seen.rms_spread * ook.bit_rate >= _IDLE * SHORT

    def spreads(self, at: Variant) -> bool:
        """Return whether the response of the channel spreads the pulses of a variant."""
        ook = self.behind(at).detector if self.count(at) else None
        return ook is not None and ook.spread_in_bits >= SHORT

    def behind(self, at: Variant, part: bool = False) -> Variant:
        """Return a variant whose transmission includes the response of its channel.

        That of all chains, or of a third of them: its square error is three times as large, and
        that of the difference of both twice.
        """
        if not self.count(at):
            return at
        assert at.detector is not None
        return at._replace(detector=at.detector.replace(response=self._of(at)[int(part)]))

    def _of(self, at: Variant) -> tuple[ChannelResponse | None, ...]:
        """Return the response of a variant by all chains, and by a third of them."""
        # the response follows from link, sea and airframe: electronics and daylight do not count
        models = [part and part.model_dump(mode="json") for part in (at.link, at.uav)]
        key = digest_of([*models, None if at.sea is None else surface_config(at.sea)])
        if key not in self._responses:
            lights = self._light_of(at)
            if self._aligned and not self._responses:  # the first one is that of the base
                self._pulses = _neighbours_pulses(light_response(at.link, lights))
            self._responses[key] = (
                light_response(at.link, lights, self._pulses),
                light_response(at.link, list(map(_third, lights)), self._pulses),
            )
        return self._responses[key]


def _third(table: Light) -> Light:
    """Return the light of every third shift of the chains, scaled up to all of them."""
    # unscattered light belongs to no shift and stays whole
    chosen = table.shift % _PARTS == 0
    share = np.where(table.shift < 0, 1.0, chosen * SHIFTS / len(range(0, SHIFTS, _PARTS)))
    return table._replace(weight=table.weight * share)


def _neighbours_pulses(response: ChannelResponse | None) -> tuple[float, ...] | None:
    """Return delays [s] of pulses that also suit responses up to four times as long."""
    if response is None or len(response.delay) < 2:
        return None
    # delays of the base and, beyond the longest, in the same ratio
    *_, before, last = response.delay
    ratio = min(max(last / max(before, 1e-300), 1.05), _BEYOND)
    more = math.ceil(math.log(_BEYOND) / math.log(ratio))
    return (*response.delay, *(last * ratio ** np.arange(1, more + 1)).tolist())
