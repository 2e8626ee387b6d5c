"""Gains of several links, or of both directions of one, over common seas."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from typing import Annotated, Any, ClassVar, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import NonNegative, Shape, check_call
from meshtrace.comms.background import DARK, warn_of_background, with_background
from meshtrace.daylight.light import Daylight
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Described, Refused, require_finite, warn
from meshtrace.fading.spectral import band_fading
from meshtrace.link import Link
from meshtrace.mesh import MeshSource
from meshtrace.models import Floats
from meshtrace.results.series import GainSeries
from meshtrace.results.tallies import error_of_groups
from meshtrace.scenario import Scenario
from meshtrace.stored import Stacked, Stored, Variable
from meshtrace.studies.background import background_over_seas, error_rate, light_of, transmission_of
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.neighbours import DECIBELS
from meshtrace.studies.response import through_channel
from meshtrace.studies.series import gain_series
from meshtrace.tables import text_table


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Stored, kind="comparison", title="meshtrace comparison of links"):
    """Gains of several links and their differences from the first one.

    Attributes
    ----------
    names : tuple of str
        Names of the links.
    gain, gain_stderr : ndarray, shape (links,)
        Gain of each link, and its standard error.
    difference, difference_stderr : ndarray, shape (links,)
        Gain minus that of the first link, and its standard error.
    ratio_db, ratio_db_stderr : ndarray, shape (links,)
        10 log10 of the gain over that of the first link [dB], and its standard error.
    provenance : list of dict
        Configuration of each link.
    background_radiance, background_radiance_stderr : ndarray, shape (links,), optional
        Background light of each link [W m-2 sr-1 nm-1], and its standard error; None without
        daylight.
    ber, ber_stderr : ndarray, shape (links,), optional
        Bit error rate of each link under its light (`lights`), and its standard error; None
        without daylight.
    """

    names: Annotated[tuple[str, ...], Variable("link", name="link")]
    gain: Annotated[Floats, Variable("link")]
    gain_stderr: Annotated[Floats, Variable("link")]
    difference: Annotated[Floats, Variable("link", name="gain_difference")]
    difference_stderr: Annotated[Floats, Variable("link", name="gain_difference_stderr")]
    ratio_db: Annotated[Floats, Variable("link", name="gain_ratio_db")]
    ratio_db_stderr: Annotated[Floats, Variable("link", name="gain_ratio_db_stderr")]
    provenance: list[dict[str, Any]] = field(default_factory=list)
    background_radiance: Annotated[Floats | None, Variable("link")] = None
    background_radiance_stderr: Annotated[Floats | None, Variable("link")] = None
    ber: Annotated[Floats | None, Variable("link")] = None
    ber_stderr: Annotated[Floats | None, Variable("link")] = None

    @classmethod
    def of_samples(
        cls,
        names: tuple[str, ...],
        samples: Annotated[Floats, Shape("links n")],
        provenance: list[dict[str, Any]],
        shifts: Annotated[Floats | None, Shape("links n")] = None,
    ) -> Comparison:
        r"""Return the comparison of paired gains.

        Parameters
        ----------
        names : tuple of str
            Names of the links.
        samples : ndarray, shape (links, n)
            Gains of n independent groups or seas, each common to all links.
        provenance : list of dict
            Configuration of each link.
        shifts : ndarray, shape (links, n), optional
            Gains averaged over all seas, by group of the chains or photons that these have in
            common: a second, independent source of error.

        Notes
        -----
        With the mean gains h, the standard error of the ratio r = h_i / h_0 is that of the mean
        of :math:`h_i - r h_0`, over h_0 (delta method).
        """
        if not len(names) == len(samples) > 0:
            names_of_links = Described(f"{len(names)} names of {len(samples)} links")
            raise Refused("names, samples", names_of_links, "a name for each link, one or more")
        gain = samples.mean(axis=1)

        def error(factor: Floats) -> Floats:
            """Return the errors of the gains less a factor (links,) of the first gain."""
            groups = [samples] if shifts is None else [samples, shifts]
            errors = (error_of_groups(x - factor[:, None] * x[0], axis=1) for x in groups)
            return np.asarray(reduce(np.hypot, errors))

        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = gain / gain[0]
            # delta method: h_0 cancels what both gains share
            relative = error(ratio) / gain
            ratio_db = 10.0 * np.log10(ratio)
        stderr, stderr_difference = error(np.zeros_like(gain)), error(np.ones_like(gain))
        difference, ratio_stderr = gain - gain[0], DECIBELS * relative
        return cls(names, gain, stderr, difference, stderr_difference, ratio_db, ratio_stderr,
                   provenance)  # fmt: skip

    @property
    def lights(self) -> tuple[str, ...]:
        """Name of the light above each link."""
        days = [record.get("daylight") for record in self.provenance]
        return tuple(DARK if day is None else str(day["light"]) for day in days)

    def _origin_lines(self) -> list[str]:
        return list(self.lights)

    def _headline(self) -> str:
        rest = [
            f"{name} {db:+.2f} +- {error:.2g} dB"
            for name, db, error in zip(self.names, self.ratio_db, self.ratio_db_stderr, strict=True)
        ]
        return f"{self.names[0]} {self.gain[0]:.4e}, {', '.join(rest[1:])}"

    def summary(self) -> str:
        """Return gains and differences as a table for a terminal."""
        cells = [
            (
                name,
                f"{self.gain[i]:.4e} +- {self.gain_stderr[i]:.1e}",
                f"{self.difference[i]:+.3e} +- {self.difference_stderr[i]:.1e}" if i else "",
                f"{self.ratio_db[i]:+.3f} +- {self.ratio_db_stderr[i]:.2g}" if i else "",
            )
            for i, name in enumerate(self.names)
        ]
        first = self.names[0]
        headings = ("link", "gain", f"difference from {first}", f"gain over {first} [dB]")
        table = text_table(cells, headings)
        return table if self.ber is None else f"{table}\n\n{self._by_light()}"

    def _by_light(self) -> str:
        """Return background and bit error rate of each link as a table."""
        columns = self.background_radiance, self.background_radiance_stderr, self.ber
        numbers = zip(*(np.asarray(c) for c in (*columns, self.ber_stderr)), strict=True)
        table = [
            (name, f"{background:.3e} +- {error:.1e}", f"{ber:.3e} +- {spread:.1e}", kind)
            for name, (background, error, ber, spread), kind in zip(
                self.names, numbers, self.lights, strict=True
            )
        ]
        return text_table(table, ("link", "background [W m-2 sr-1 nm-1]", "BER", "light"))


@check_call
def compare(
    links: Mapping[str, Link | Scenario],
    surface: MeshSource | None = None,
    *,
    realizations: Annotated[int, Field(ge=1, le=10_000_000)] = 1,
    daylight: Daylight | None = None,
    **run: Unpack[StudyOptions],
) -> Comparison:
    """Compare the gains of links over common seas with common chains.

    With daylight, also their background light and bit error rates.

    Parameters
    ----------
    links : mapping of str to Link or Scenario
        Two links or more by name, each with one receiver; differences are from the first.
    surface : MeshSource, optional
        The sea; by default that of each scenario, or a JONSWAP sea of the wind of each link.
    realizations : int
        Realizations of the sea, 1 to 10 000 000. A single one has the seed of the sea.
    daylight : Daylight, optional
        Light above all links; by default that of each scenario.
    **run
        Options of the run, see `StudyOptions`; progress is by realization of each link.

    Returns
    -------
    Comparison

    Raises
    ------
    Refused
        If there are fewer than two links, one of them has several receivers, or the sea has no
        random phases and `realizations` > 1.

    Notes
    -----
    The links share the numbers of their chains and, over equal seas, one mesh: errors common to
    both links cancel in the difference. For one sea its error comes from the 32 randomizations of
    the chains, for several from these and from the scatter over the seas.

    Bit error rates are those of the receiver of each scenario ("physical" without one), averaged
    over the seas, with the mean background of them. For several seas the mesh then
    holds all waves that make the light of each link fade, unless `waves` of the meshing says
    otherwise.
    """
    if len(links) < 2:
        raise Refused("links", sorted(links), "a mapping of two or more names to links")
    in_daylight = daylight is not None or any(
        getattr(link, "daylight", None) for link in links.values()
    )
    each = {}
    for name, link in links.items():
        try:
            fading = in_daylight and realizations > 1
            resolved = campaign_of(link, surface, "compare", run, fading=fading)
            count = len(resolved.link.receivers)
            if count != 1:
                raise Refused("receiver", Described(f"{count} receivers"), "one receiver")
        except Refused as error:
            raise error.inside("links", str(name)) from None
        each[str(name)] = resolved.for_link(resolved.link, str(name))
    groups = _gains(each, realizations)  # (links, seas, shifts)
    over_seas, over_shifts = groups.mean(axis=2), groups.mean(axis=1)
    several = realizations > 1
    days = [light_of(campaign, daylight) for campaign in each.values()]
    origin = [
        campaign.provenance(of_study={"realizations": realizations})
        | {"daylight": day and day.model_dump(mode="json")}
        for campaign, day in zip(each.values(), days, strict=True)
    ]
    made = Comparison.of_samples(
        tuple(each), over_seas if several else over_shifts, origin, over_shifts if several else None
    )
    return _under_light(made, list(each.values()), days, groups, realizations)


def _under_light(
    result: Comparison,
    campaigns: list[Campaign],
    days: list[Daylight | None],
    groups: Floats,
    realizations: int,
) -> Comparison:
    """Add background and bit error rate of each link to a comparison, if any has daylight.

    `groups` are the gains (links, seas, shifts).
    """
    if not any(days):
        return result
    table = []
    # what all seas have in common; `error_rate` adds their spread
    errors = error_of_groups(groups.mean(axis=1), axis=1).tolist()
    for campaign, day, gains, error in zip(
        campaigns, days, groups.mean(axis=2), errors, strict=True
    ):
        base = campaign.scenario.detector if campaign.scenario is not None else None
        ook = through_channel(transmission_of(campaign.link, base), campaign, realizations)
        background = background_over_seas(campaign, day, realizations) if day else None
        if background is not None:
            warn_of_background(with_background(ook, background), background)
        radiance = (background.radiance, background.radiance_stderr) if background else (0.0, 0.0)
        table.append([*radiance, *error_rate(ook, gains, error, background)])
    radiance_of, radiance_stderr, ber, ber_stderr = np.array(table).T
    return replace(
        result, background_radiance=radiance_of, background_radiance_stderr=radiance_stderr,
        ber=ber, ber_stderr=ber_stderr,
    )  # fmt: skip


def _gains(each: dict[str, Campaign], realizations: int) -> Floats:
    """Return the gains of the links over each sea by group of chains, (links, seas, shifts).

    Links over equal seas, with equal chains, have common meshes.
    """
    campaigns = list(each.values())
    conditions = [(campaign.surface, campaign.meshing, campaign.run) for campaign in campaigns]
    # one mesh and one set of numbers: errors cancel in the differences
    if all(campaign == conditions[0] for campaign in conditions):
        links = {name: campaign.link for name, campaign in each.items()}
        campaigns = [campaigns[0]._replace(links=links)]
    table = []
    for campaign in campaigns:
        still = campaign.in_time(np.array([campaign.meshing.time]))
        steps = campaign.realizations(realizations) if realizations > 1 else still
        tick = campaign.progress and partial(_of_each, campaign.progress, len(campaign.links))
        table.append(campaign._replace(progress=tick).gains(steps)[0, :, :, 0])
    return np.concatenate(table)


def _of_each(progress: Callable[[int], None], links: int, n: int) -> None:
    """Call progress once for each link of a surface."""
    for _ in range(links):
        progress(n)


class JointOutage(NamedTuple):
    """Shares of the surfaces with gains below their thresholds.

    Attributes
    ----------
    up, down : float
        Outage of each direction.
    both, either : float
        Outage of both at once, and of at least one.
    independent : float
        Outage of both at once if the fades were independent, up times down.
    """

    up: float
    down: float
    both: float
    either: float
    independent: float


@dataclass(frozen=True, eq=False, repr=False)
class Duplex(Stacked, kind="duplex", title="meshtrace gains of both directions"):
    """Gains of an uplink and a downlink over the same surfaces.

    Attributes
    ----------
    up, down : GainSeries
        Gains of each direction, over the same times or realizations.
    """

    up: GainSeries
    down: GainSeries

    _along: ClassVar[tuple[str, str]] = ("direction", "direction")

    @property
    def correlation(self) -> float:
        """Pearson's correlation of the gains of both directions; nan if one of them is constant."""
        both = self.up.gain, self.down.gain
        constant = len(both[0]) < 2 or min(map(np.ptp, both)) == 0.0
        return math.nan if constant else float(np.corrcoef(*both)[0, 1])

    @property
    def correlation_stderr(self) -> float:
        """Standard error of the correlation r of n independent surfaces, (1 - r^2) / sqrt(n - 1).

        Surfaces of a time series are correlated: the error is then larger.
        """
        return float((1.0 - self.correlation**2) / math.sqrt(max(len(self.up.gain) - 1, 1)))

    def outage(self, up_gain: NonNegative, down_gain: NonNegative) -> JointOutage:
        """Return the outage of each direction, and of both.

        Parameters
        ----------
        up_gain, down_gain : float
            Least gain of each direction with a connection, >= 0.
        """
        up, down = self.up.gain < up_gain, self.down.gain < down_gain
        alone = float(up.mean()), float(down.mean())
        both, either = float((up & down).mean()), float((up | down).mean())
        return JointOutage(*alone, both, either, alone[0] * alone[1])

    def _headline(self) -> str:
        means = f"up {self.up.gain.mean():.4e}, down {self.down.gain.mean():.4e}"
        return f"{len(self.up.gain)} surfaces, {means}, correlation {self.correlation:.3f}"

    def summary(self) -> str:
        """Return mean, scintillation index and joint fades below half of the mean as text."""
        lines = []
        for name, series in (("up", self.up), ("down", self.down)):
            gain = series.gain
            index = gain.var(ddof=1) / gain.mean() ** 2 if gain.any() else math.nan
            lines.append(
                f"{name:<6} mean gain {gain.mean():.4e} +- {series.mean_stderr:.1e}, "
                f"scintillation index {index:.3g}"
            )
        # a fade of 3 dB
        half = self.outage(0.5 * float(self.up.gain.mean()), 0.5 * float(self.down.gain.mean()))
        lines += [
            f"correlation of the gains   {self.correlation:.3f} +- {self.correlation_stderr:.2g}",
            f"below half of the mean     up {half.up:.3g}, down {half.down:.3g}, both "
            f"{half.both:.3g} (independent: {half.independent:.3g}), either {half.either:.3g}",
        ]
        return "\n".join(lines)

    def _stack(self) -> tuple[Any, tuple[GainSeries, GainSeries]]:
        return ["up", "down"], (self.up, self.down)

    @classmethod
    def _of_stack(cls, labels: Any, results: tuple[Any, ...]) -> Duplex:
        return cls(*results)


@check_call
def duplex(
    up: Link,
    down: Link,
    surface: MeshSource,
    times: ArrayLike | None = None,
    *,
    realizations: Annotated[int, Field(ge=1, le=10_000_000)] | None = None,
    **run: Unpack[StudyOptions],
) -> Duplex:
    """Return the gains of an uplink and a downlink over the same surfaces, by forced detection.

    Parameters
    ----------
    up, down : Link
        Links of one receiver each: a source in the water and a receiver in the air, and a lamp in
        the air and a receiver in the water.
    surface : MeshSource
        The sea: moving, or with random phases.
    times : array_like, shape (n,), optional
        Times [s] of a moving sea.
    realizations : int, optional
        Number of realizations of a random sea, in place of the times.
    **run
        Options of the run, see `StudyOptions`; chains are those of each direction.

    Returns
    -------
    Duplex

    Raises
    ------
    Refused
        If a link has another direction or several receivers, an option is out of range, or
        neither or both of `times` and `realizations` are given.

    Notes
    -----
    Each surface is one mesh for both directions, fine where the light of either crosses. Unless
    `waves` of the meshing says otherwise, it holds all waves that make the light of the uplink
    fade: its gains are those of the uplink alone.

    Examples
    --------
    >>> import meshtrace as mt
    >>> both = mt.duplex(mt.Link(), mt.Link().mirrored(), mt.surfaces.sea_in_wind(5.0),
    ...                  realizations=3, photons=256)
    >>> len(both.up.gain), len(both.down.gain)
    (3, 3)
    """
    pair = (campaign_of(link, surface, "duplex", run, fading=link is up) for link in (up, down))
    campaign = both_directions(*pair)
    if (times is None) == (realizations is None):
        raise Refused("times", times, "times, or a number of realizations")
    if realizations is not None:
        steps = campaign.realizations(realizations)
    else:
        steps = campaign.in_time(require_finite(times, "times", "finite times (n,) [s], n >= 1"))
    gains = campaign.gains(steps, probed=1)
    return Duplex(*(gain_series(campaign, steps, gains, name) for name in campaign.links))


def both_directions(up: Campaign, down: Campaign) -> Campaign:
    """Return the campaign of an uplink and a downlink over the sea of the uplink.

    Its gains are then those of a series of the uplink alone. The waves that make the downlink fade
    may be far shorter than any mesh can hold, where its aperture lies near to the surface.

    Warns
    -----
    UserWarning
        If the waves of the uplink omit more than a tenth of the fading of the downlink.

    Raises
    ------
    Refused
        If a link has another direction or several receivers.
    """
    for name, campaign in (("up", up), ("down", down)):
        link = campaign.link
        if link.direction != name or len(link.receivers) != 1:
            ends = Described(f"{len(link.receivers)} receivers, direction {link.direction}")
            raise Refused(name, ends, f"a link with one receiver and direction {name}")
    # seas of both links differ where short waves matter to the downlink alone
    fading = band_fading(down.link, up.surface) if down.surface != up.surface else None
    if fading is not None and fading.needed is not None:
        text = (
            f"downlink: the waves that make the uplink fade, up to {fading.omega_max:.3g} rad/s, "
            f"give it a scintillation index of {fading.index_of_band:.2g}, all waves "
            f"{fading.index_of_all:.2g}; for its fading use waves = {fading.needed:.4g}"
        )
        warn(text)
    return up._replace(links={"up": up.link, "down": down.link})
