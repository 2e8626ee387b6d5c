"""Photon paths for visualisation: analog photons, and chains of received light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains.aimed import AimedChains, on_disk
from meshtrace.engine.chains.gain import turned
from meshtrace.engine.chains.sampling import Chains
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.photons.analog import new_recorder, run_analog
from meshtrace.engine.photons.state import Recorder, Vertex
from meshtrace.engine.setup.ends import ForcedLink, forced_link
from meshtrace.engine.setup.options import BLOCK, Analog
from meshtrace.engine.straight import straight_gains
from meshtrace.errors import Described, Refused
from meshtrace.kernels.scene import Emitter, Target
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.link.link import SAME_SIDE
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats

if TYPE_CHECKING:
    import xarray as xr

_CHAINS = 4096  # from which the paths of received light are drawn
_turned = getattr(turned, "py_func", turned)  # as it is without the JIT


@dataclass(frozen=True, eq=False)
class PhotonPaths:
    """Polylines of photons with their weights.

    Attributes
    ----------
    vertex : ndarray, shape (paths, vertices, 3)
        Positions [m], nan after the end of the path.
    weight : ndarray, shape (paths, vertices)
        Weight with which the photon leaves the vertex, nan after the end.
    what : ndarray of int8, shape (paths, vertices)
        `Vertex` codes, -1 after the end.
    photon : ndarray of int64, shape (paths,)
        Photon that a path belongs to; light reflected by the surface starts a new path.
    """

    vertex: Floats
    weight: Floats
    what: NDArray[np.int8]
    photon: NDArray[np.int64]

    @property
    def length(self) -> NDArray[np.int64]:
        """Number of vertices of each path."""
        return (self.what >= 0).sum(axis=1)

    @property
    def received(self) -> NDArray[np.bool_]:
        """Mask of the paths that end in an aperture."""
        return (self.what == Vertex.RECEIVED).any(axis=1)

    @property
    def final(self) -> NDArray[np.int8]:
        """`Vertex` code at the end of each path."""
        return self.what[np.arange(len(self.what)), self.length - 1]

    def polylines(self) -> tuple[Floats, NDArray[np.int64]]:
        """Return points (n, 3) and VTK cells: the count of each line before its points."""
        used = self.what >= 0
        points = self.vertex[used]
        # a cell of VTK is (count, index, index, ...): counts go before the index of the first point
        starts = np.cumsum(self.length) - self.length
        return points, np.insert(np.arange(len(points)), starts, self.length)

    def to_dataset(self) -> xr.Dataset:
        """Return the paths as an xarray Dataset."""
        import xarray as xr

        names = " ".join(v.name.lower() for v in Vertex)
        flags = {"flag_values": np.array(list(Vertex), np.int8), "flag_meanings": names}
        return xr.Dataset(
            {
                "vertex": (("path", "step", "axis"), self.vertex, {"units": "m"}),
                "weight": (("path", "step"), self.weight, {"units": "1"}),
                "what": (("path", "step"), self.what, flags),
                "photon": ("path", self.photon),
            },
            {"axis": ["x", "y", "z"]},
        )


def record_paths(
    link: Link,
    mesh: TriangleMesh,
    n: int,
    seed: int,
    normals: str,
    max_vertices: int,
    options: Analog,
) -> PhotonPaths:
    """Return the paths of the first n analog photons, the same ones as in a run that tallies."""
    recorder = new_recorder(n, max_vertices)
    run_analog(
        link,
        EmbreeIntersector(mesh, 1),
        # one chunk, as the recorder has room for n photons only: n rounded up to whole blocks
        options.replace(batch_size=max(-(-n // BLOCK) * BLOCK, BLOCK)),
        photons=n,
        seed=seed,
        normals=normals,
        recorder=recorder,
    )
    return _split(recorder)


def _empty(longest: int, photon: NDArray[np.int64]) -> PhotonPaths:
    """Return paths of the given photons to be filled in, of up to `longest` vertices each."""
    recorder = new_recorder(len(photon), longest)
    return PhotonPaths(recorder.vertex, recorder.weight, recorder.what, photon)


def _split(recorder: Recorder) -> PhotonPaths:
    """Return the paths of recorded photons, split where light is reflected by the surface.

    A path ends where it is received or lands.
    """
    pieces: list[tuple[int, int, int]] = []  # photon, first vertex and one beyond the last
    for i, n in enumerate(recorder.length):
        codes = recorder.what[i, :n]
        starts = [0, *np.flatnonzero(codes == Vertex.BRANCH)]
        for a, b in zip(starts, [*starts[1:], n], strict=True):
            # a photon that has left the water is not followed beyond its landing
            left = np.flatnonzero((codes[a:b] == Vertex.RECEIVED) | (codes[a:b] == Vertex.LANDED))
            end = a + left[0] + 1 if len(left) else b
            if end - a > 1:
                pieces.append((i, int(a), int(end)))
    # paths of unequal length share one array: the rest stays nan and -1
    longest = max((b - a for _, a, b in pieces), default=1)
    out = _empty(longest, np.array([i for i, _, _ in pieces], np.int64))
    for k, (i, a, b) in enumerate(pieces):
        for name in ("vertex", "weight", "what"):
            getattr(out, name)[k, : b - a] = getattr(recorder, name)[i, a:b]
    return out


def received_paths(link: Link, mesh: TriangleMesh, n: int, seed: int, normals: str) -> PhotonPaths:
    """Return n paths of light into the first receiver, sampled in proportion to their weight.

    Paths go from the source by way of the scatterings and the crossing to the aperture; all carry
    the same share of the gain. Scattered light is that of chains, even where the gain is estimated
    by joined photons. Between ends on one side there is none: light goes straight or by the mirror.
    """
    # 1 names the stream of the draws of this function
    rng = np.random.default_rng([seed, 1])
    if link.direction in SAME_SIDE:
        arrays = forced_link(link)
        aimed = AimedChains(arrays, mesh, normals, link.physics.unresolved)
        sets = _straight_and_mirrored(aimed, n, rng)
    else:
        sea = TypicalSea.of_meshes([mesh])
        forced = ForcedDetection(link, _CHAINS, seed, normals, sea=sea, scattered="chains")
        arrays = forced.arrays
        sets = _chained(forced, mesh, n, rng)
    if not sets:
        dark = Described("no light is received")
        raise Refused("received_only", dark, "a link that receives some")
    # a second draw over all orders and sources, again in proportion to the light
    shares = np.repeat([gain / count for gain, count, _ in sets], [count for _, count, _ in sets])
    chosen = rng.choice(len(shares), n, p=shares / shares.sum())
    first = np.cumsum([0, *(count for _, count, _ in sets)])
    set_of = np.searchsorted(first, chosen, side="right") - 1
    placed = []
    for i in np.unique(set_of):
        paths = np.flatnonzero(set_of == i)
        placed.append((paths, sets[i][2](chosen[paths] - first[i])))
    out = _empty(max(points.shape[1] for _, points in placed), np.arange(n, dtype=np.int64))
    from_air = arrays.direction in ("down", "over")
    for paths, points in placed:
        m = points.shape[1]
        # light that goes down is followed backwards: the order of its vertices is reversed
        out.vertex[paths, :m] = arrays.frame.metres(points[:, :: -1 if arrays.down else 1])
        out.weight[paths, :m] = float(shares.sum()) / n
        out.what[paths, :m] = Vertex.SCATTER
        # straight light meets no surface: its source takes this place
        out.what[paths, 1 if arrays.down else m - 2] = (
            Vertex.SURFACE_IN if from_air else Vertex.SURFACE_OUT
        )
        out.what[paths, 0] = Vertex.SOURCE
        out.what[paths, m - 1] = Vertex.RECEIVED
    return out


_Place = Callable[[NDArray[np.intp]], Floats]
_Set = tuple[float, int, _Place]
"""Light of a set of paths, their number, and a function for the points (k, m, 3) of some."""


def _chained(
    forced: ForcedDetection, mesh: TriangleMesh, n: int, rng: np.random.Generator
) -> list[_Set]:
    """Return up to n paths of each set of chains to the first receiver."""
    # chains without a scattering stand for unscattered light: its integral over the facets follows
    # no paths
    aimed, sets = forced.planner.aim_over(mesh), forced.sets(unscattered=True)
    arrays, drawn_sets = forced.arrays, list[_Set]()
    # To the first receiver: target 0 of each source of an uplink. Chains of a downlink run
    # backwards: emitter 0 is the receiver, and the targets are the sources.
    for s, power in enumerate(arrays.power):
        e, t = (0, s) if arrays.down else (s, 0)
        for chain_set in map(forced.drawer.whole, sets[e]):
            _, arrivals = aimed.aim(e, t, chain_set, keep=True)
            # the gain is the mean over all chains
            weight = power * arrivals["weight"] / chain_set.number
            if not weight.sum() > 0.0:
                continue
            # drawn with replacement, in proportion to weight: each drawn path stands for the same
            # light
            drawn = rng.choice(len(arrivals), min(n, len(arrivals)), p=weight / weight.sum())
            ends = arrays.emitters[e], arrays.targets[t]
            place = partial(_of_chains, chain_set.chains, arrivals[drawn], ends)
            drawn_sets.append((float(weight.sum()), len(drawn), place))
    return drawn_sets


def _of_chains(
    chains: Chains, arrivals: NDArray[np.void], ends: tuple[Emitter, Target],
    chosen: NDArray[np.intp],
) -> Floats:  # fmt: skip
    """Return the points (chosen, m, 3) of some of the chains that arrive."""
    return _placed(chains, arrivals[chosen], *ends)


def _straight_and_mirrored(aimed: AimedChains, n: int, rng: np.random.Generator) -> list[_Set]:
    """Return n paths straight from each source to the first receiver, and n by the mirror."""
    link: ForcedLink = aimed.link
    drawn_sets = list[_Set]()
    for e, emitter in enumerate(link.emitters):
        # points of the disk: uniform in azimuth and in the square of the radius
        u = rng.random((2, n))
        radius, azimuth = np.sqrt(u[0]), 2.0 * np.pi * u[1]
        disk = radius[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        ends, start = on_disk(link.targets[0].center, link.targets[0], disk), emitter.position
        straight, _ = straight_gains(link, aimed.intersector, link.medium, e, 0)
        if straight > 0.0:
            points = np.stack([np.broadcast_to(start, ends.shape), ends], axis=1)
            drawn_sets.append((link.share(e, 0) * straight, n, points.__getitem__))
        by_facet = aimed.direct_gains(e, 0)
        mirrored = float(by_facet.sum())
        if mirrored > 0.0:
            facets = rng.choice(len(by_facet), n, p=by_facet / mirrored)
            at = _mirror_points(aimed, facets, np.array(start), ends)
            points = np.stack([np.broadcast_to(start, ends.shape), at, ends], axis=1)
            drawn_sets.append((link.share(e, 0) * mirrored, n, points.__getitem__))
    return drawn_sets


def _mirror_points(
    aimed: AimedChains, facets: NDArray[np.int64], start: Floats, ends: Floats
) -> Floats:
    """Return where plane facets (n,) mirror light from a start to ends (n, 3).

    That is the centroid of a facet which mirrors it by another slope than its own: one between
    those of its corners, or a random one.
    """
    surface, centroids = aimed.surface, aimed.centroids[facets]
    normal = surface.face_normals[facets]
    # the straight line from the image of the start behind the plane of the facet
    height = np.einsum("ij,ij->i", start - centroids, normal)
    image = start - 2.0 * height[:, None] * normal
    way = ends - image
    with np.errstate(divide="ignore", invalid="ignore"):
        share = height / np.einsum("ij,ij->i", way, normal)
    place = image + share[:, None] * way
    corners = surface.vertices[surface.faces[facets]]  # (n, 3, 3)
    edges = np.roll(corners, -1, axis=1) - corners
    # left of all three edges, seen along the normal
    turn = np.einsum("ikj,ij->ik", np.cross(edges, place[:, None] - corners), normal)
    within = (turn >= 0.0).all(axis=1)
    return np.where(within[:, None], place, centroids)


def _placed(chains: Chains, arrivals: NDArray[np.void], emitter: Emitter, target: Target) -> Floats:
    """Return the points (arrivals, n, 3) of chains from emitter to target, in local coordinates."""
    # chains are drawn as if emitted along z: turned as a whole, they leave along the direction
    # `emission`; their vertices are relative to the start
    i = arrivals["chain"]
    emission = Vec3(*arrivals["emission"].T[..., None])
    vertices = np.stack(_turned(emission, Vec3(*np.moveaxis(chains.vertex[i], -1, 0))), axis=-1)
    start, end = (
        on_disk(center, disk, chains.disk[i])[:, None]
        for center, disk in ((emitter.position, emitter), (target.center, target))
    )
    return np.concatenate([start, vertices + start, arrivals["point"][:, None], end], axis=1)
