"""Mean gains of links near one link, with common random numbers over its mean sea."""

from __future__ import annotations

from functools import partial

import numpy as np

from meshtrace.engine.forced import MANY_SEAS, ForcedDetection, Scattered, TypicalSea
from meshtrace.link import Link
from meshtrace.mesh import SeededSurface, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.studies.background import mean_sea
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.neighbours import error_of, without_each

_SEAS, _RESOLVED_SEAS = 2, 6  # where each has the mean gain, and where waves are resolved


class MeanGains:
    """Ratios of the mean gains of links near one link to its own.

    Parameters
    ----------
    campaign : Campaign
        The link, its sea and options.
    seas : int
        Seas, at most.

    Notes
    -----
    The sea is the `mean_sea` of the link: random slopes have the mean gain of resolved waves, with
    a hundredth of their variance. Links that differ by their receivers are receivers of one run,
    and scattered light rests on joined photons for all of them where it does for the link.
    """

    def __init__(self, campaign: Campaign, seas: int) -> None:
        self._link, run = campaign.link, campaign.run
        sea = mean_sea(campaign.link, campaign.surface)
        most = _RESOLVED_SEAS if sea is campaign.surface else _SEAS
        self.campaign = campaign._replace(surface=sea, progress=None)
        if isinstance(sea, SeededSurface):
            self.steps = self.campaign.realizations(min(seas, most))
        else:
            self.steps = self.campaign.in_time(np.array([campaign.meshing.time]))
        self.seas = len(self.steps.labels)
        self._options = run.photons, run.seed, campaign.meshing.normals, campaign.threads
        self._known: dict[Link, Floats] = {self._link: np.zeros(1)}
        self._scattered: Scattered | None = None
        self._own: Floats | None = None

    def ratio(self, link: Link, over: Link | None = None) -> tuple[float, float]:
        """Return the logarithm of the ratio of two mean gains, and its standard error."""
        self.find([link] if over is None else [link, over])
        logs = self._known[link] - (0.0 if over is None else self._known[over])
        return float(logs[0]), error_of(logs)

    def find(self, links: list[Link]) -> None:
        """Find the gains of links in as few runs as possible."""
        groups: dict[Link, list[Link]] = {}
        for link in dict.fromkeys(links):
            if link not in self._known:
                groups.setdefault(link.replace("receiver", self._link.receiver), []).append(link)
        for base, some in groups.items():
            if base == self._link:
                logs = self._logs([self._link, *some])
                found = logs[1:] - logs[0]
            else:
                if self._own is None:
                    (self._own,) = self._logs([self._link])
                found = self._logs(some) - self._own
            self._known |= dict(zip(some, found, strict=True))

    def _logs(self, links: list[Link]) -> Floats:
        """Return the logarithms of gains (links, 1 + groups) of links with one lamp."""
        receivers = tuple(link.receivers[0] for link in links)
        whole = links[0].replace("receiver", receivers if len(links) > 1 else receivers[0])
        meshes = list(ordered_map(partial(self._mesh, whole), range(self.seas), self._options[-1]))
        sea = TypicalSea.of(meshes, MANY_SEAS)
        if self._scattered is None:
            alone = ForcedDetection(self._link, *self._options, sea)
            self._scattered = "joined" if set(alone.method) == {"joined"} else "auto"
        clear = whole.water.layers is None and whole.water.b == 0.0
        scattered: Scattered = "chains" if clear else self._scattered
        chains = ForcedDetection(whole, *self._options, sea, scattered=scattered)
        parts = [chains.evaluate(mesh).shifts for mesh in meshes]  # (receivers, shifts) each
        gains = np.moveaxis(np.array(parts), 1, 0)
        rows = [[some.mean() for some in without_each(one)] for one in gains]
        return np.log(np.maximum(np.array(rows), 1e-300))

    def _mesh(self, link: Link, i: int) -> TriangleMesh:
        """Return the mesh of a sea for a link."""
        return self.campaign.mesh([link], *self.steps.surface(i))
