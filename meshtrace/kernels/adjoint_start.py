"""Start of adjoint paths: from the aperture through the surface into the water.

Directions are drawn from a mixture of a cosine lobe over the field of view and of lobes about the
directions of unscattered light; `kernels.adjoint` follows the paths in the water.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.facets import (
    Surface,
    drawn_tilt,
    exposure,
    normal_at,
    plane_distance,
    tilted,
)
from meshtrace.kernels.interface import FieldOfView, FresnelMode, Interface, reflectance, refract
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.line_estimate import Optics
from meshtrace.kernels.medium import absorption_path
from meshtrace.kernels.random import uniforms
from meshtrace.kernels.scene import Target, height_on
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.vectors import (
    UP,
    Vec2,
    Vec3,
    along,
    dot,
    minus,
    norm,
    on_circle,
    row,
    scaled,
    turn,
    unit,
    write,
)

# what a draw is for; the key of the stream belongs to one source and one receiver
_START, _TILT, LOOK = range(3)
FIRST_STREAM = 3
"""First stream of random numbers behind the start."""

# Paths.state
STARTED, WALKING, WAITING, ENDED = range(4)
_NEWTON = 4  # steps on the plane of one facet


class Paths(NamedTuple):
    """A block of paths."""

    lamp: NDArray[np.float64]  # (n, 3) point of the source
    point: NDArray[np.float64]  # (n, 3) on the aperture, then the start of the segment
    direction: NDArray[np.float64]  # (n, 3) of the segment, against the light
    tilt: NDArray[np.float64]  # (n, 2) slopes on top of those of the mesh
    root: NDArray[np.float64]  # (n, roots, 2) crossings (x, y) of unscattered light
    lobe: NDArray[np.float64]  # (n, lobes, 3) directions from the aperture to crossings
    weight: NDArray[np.float64]  # (n,)
    length: NDArray[np.float64]  # (n,) of the segment, where a wave may cut it
    water: NDArray[np.float64]  # (n,) way in the water up to `point`
    importance: NDArray[np.float64]  # (n,) of the crossing
    heaviest: NDArray[np.float64]  # (n,) weight behind the crossing
    state: NDArray[np.int64]  # (n,)
    order: NDArray[np.int64]  # (n,) scatterings so far
    event: NDArray[np.int64]  # (n,) draws so far
    branch: NDArray[np.float64]  # (n, branches, 9) point, direction, weight, order, way
    branches: NDArray[np.int64]  # (n,) side paths that are left
    score: NDArray[np.float64]  # (n, orders)


class World(NamedTuple):
    """Inputs common to the paths of one source and one receiver."""

    optics: Optics
    target: Target
    surface: Surface
    interface: Interface
    size: float  # radius of the source [m]
    lobe_bubble: float  # share of lobes drawn by the phase function of the bubbles
    axis: Vec3  # of the cone of directions, away from the aperture
    cos_cone: float
    even: float  # share of free paths drawn evenly over the distance to the source
    aimed: float  # chance of a side path about the direction to the source
    beam: float  # standard deviation of the beam of a narrow source [rad], 0 of a wide one
    fan: float  # share of side paths towards the beam
    lit: float  # share of free paths drawn about the beam
    key: np.uint64
    first: int  # index of the first path of the block


@inlined
def is_flat(surface):
    """Return whether a surface is still water.

    Array twin: numpy.ptp of the heights.
    """
    return surface.max_slope == 0.0 and surface.low[2] == surface.high[2]


@entry
def begin(paths, starts, world):
    """Draw points of the aperture and of the source, random slopes and guesses of crossings.

    Array twin: moments in the tests.
    `starts` are crossings (x, y) of light to the centre of the aperture.
    """
    emitter, target = world.optics.emitter, world.target
    n = world.optics.medium.n_water / world.optics.medium.n_air
    for i in range(len(paths.weight)):
        u, v, u_lamp, v_lamp = uniforms(world.key, world.first + i, 0, _START)
        r = target.radius * math.sqrt(u)
        cos_phi, sin_phi = on_circle(v)
        side = along(target.center, target.e1, r * cos_phi)
        write(paths.point[i], along(side, target.e2, r * sin_phi))
        write(paths.lamp[i], emitter.position)
        if world.size > 0.0:
            gaussian = emitter.kind == SourceKind.GAUSSIAN_BEAM
            r = world.size * math.sqrt(-0.5 * math.log(u_lamp) if gaussian else u_lamp)
            across = turn(emitter.axis, 0.5, v_lamp)
            write(paths.lamp[i], along(emitter.position, across, r))
        u, v, _, _ = uniforms(world.key, world.first + i, 0, _TILT)
        tilt = drawn_tilt(world.surface.roughness, u, v)
        paths.tilt[i, 0], paths.tilt[i, 1] = tilt.x, tilt.y
        height, depth = target.center[2], max(-emitter.position[2], 0.0)
        share = n * height / (n * height + depth)
        for k in range(len(starts)):
            for j in range(2):
                paths.root[i, k, j] = (
                    starts[k, j]
                    + (1.0 - share) * (paths.point[i, j] - target.center[j])
                    + share * (paths.lamp[i, j] - emitter.position[j])
                )
        paths.weight[i], paths.state[i] = 0.0, STARTED
        paths.order[i], paths.event[i], paths.branches[i] = 0, 0, 0
        paths.water[i] = 0.0


@inlined
def _normal(x, y, facet, surface, tilt):
    n = UP
    if facet >= 0:
        n = normal_at(x, y, facet, surface)
    if tilt.x != 0.0 or tilt.y != 0.0:
        n = tilted(n, tilt)
    return n


@inlined
def _imbalance(x, y, facet, a, b, tilt, n, surface):
    """Return the derivative of the optical path from a (air) to b (water) along the surface.

    It vanishes where Snell's law holds.
    """
    p = Vec3(x, y, height_on(x, y, facet, surface))
    m = _normal(x, y, facet, surface, tilt)
    up, down = unit(minus(a, p)), unit(minus(b, p))
    hx, hy, hz = up.x + n * down.x, up.y + n * down.y, up.z + n * down.z
    return hx - m.x / m.z * hz, hy - m.y / m.z * hz


@outlined
def _stationary(x, y, facet, a, b, tilt, n, surface):
    """Return the crossing (x, y) on the plane of a facet of unscattered light from b to a."""
    size = norm(minus(a, b))
    for _ in range(_NEWTON if facet >= 0 else 3 * _NEWTON):
        h = 1e-6 * size
        f, g = _imbalance(x, y, facet, a, b, tilt, n, surface)
        fx, gx = _imbalance(x + h, y, facet, a, b, tilt, n, surface)
        fy, gy = _imbalance(x, y + h, facet, a, b, tilt, n, surface)
        fx, gx, fy, gy = (fx - f) / h, (gx - g) / h, (fy - f) / h, (gy - g) / h
        det = fx * gy - fy * gx
        if det == 0.0:
            break
        dx, dy = (fy * g - gy * f) / det, (gx * f - fx * g) / det
        step = math.sqrt(dx * dx + dy * dy)
        if step > 0.3 * size:
            dx, dy = 0.3 * size * dx / step, 0.3 * size * dy / step
        x, y = x + dx, y + dy
        if step < 1e-9 * size:
            break
    return x, y


@entry
def improve(paths, facets, kept, world):
    """Solve for the crossings of unscattered light on the facets below the last guesses.

    Array twin: Fermat's principle by scipy in the tests.
    `facets` has one row a path; `kept` is the set of lobes that takes the directions, -1 for
    none. A crossing that is wrong costs variance, never bias.
    """
    n = world.optics.medium.n_water / world.optics.medium.n_air
    roots = paths.root.shape[1]
    for i in range(len(paths.weight)):
        a, b = row(paths.point, i), row(paths.lamp, i)
        tilt = Vec2(paths.tilt[i, 0], paths.tilt[i, 1])
        for k in range(roots):
            x, y = paths.root[i, k, 0], paths.root[i, k, 1]
            x, y = _stationary(x, y, facets[i, k], a, b, tilt, n, world.surface)
            if not (abs(x) < math.inf and abs(y) < math.inf):
                x, y = a.x, a.y
            paths.root[i, k, 0], paths.root[i, k, 1] = x, y
            if kept >= 0:
                p = Vec3(x, y, height_on(x, y, facets[i, k], world.surface))
                w = unit(minus(p, a))
                j = kept * roots + k
                write(paths.lobe[i, j], w)


@entry
def enter(paths, facets, world):
    """Refract the paths at the surface; return the number that missed the mesh.

    Array twin: the analog crossing, `kernels.photon`.
    Radiance over n^2 is kept but for the transmittance; interpolated and tilted normals add the
    projected areas that the analog photon meets, so that both estimate one integral. A path from
    a lamp in the air runs with the light, and is such a photon.
    """
    medium, surface, target = world.optics.medium, world.surface, world.target
    beside = 0
    for i in range(len(paths.weight)):
        if paths.state[i] == ENDED:
            continue
        paths.state[i] = ENDED
        f = facets[i]
        if f < 0:
            beside += 1
            continue
        p, d = row(paths.point, i), row(paths.direction, i)
        t = plane_distance(p, d, f, surface)
        g = row(surface.face_normals, f)
        if not t > 0.0 or dot(d, g) >= 0.0:
            continue
        p = along(p, d, t)
        if world.interface.fov != FieldOfView.ANGLE:
            reach = target.radius + (target.center[2] - p.z) * target.tan_half_fov
            if (p.x - target.center[0]) ** 2 + (p.y - target.center[1]) ** 2 >= reach * reach:
                continue
        weight, d = _crossed(p, d, f, g, Vec2(paths.tilt[i, 0], paths.tilt[i, 1]), world)
        if weight == 0.0:
            continue
        write(paths.point[i], p)
        write(paths.direction[i], d)
        paths.weight[i] *= weight
        paths.importance[i] = paths.weight[i] * importance_at(p, row(paths.lamp, i), medium)
        if paths.importance[i] == 0.0:  # what it may score underflows
            continue
        paths.heaviest[i] = paths.weight[i]
        paths.state[i] = WALKING
    return beside


@outlined
def _crossed(p, d, f, g, tilt, world):
    """Return (factor of the weight, direction in the water) of a path at facet f."""
    medium = world.optics.medium
    n = normal_at(p.x, p.y, f, world.surface)
    m = _normal(p.x, p.y, f, world.surface, tilt)
    cos_air = -dot(d, m)
    if cos_air <= 0.0:
        return 0.0, d
    cos_water, inwards = refract(
        d, scaled(-1.0, m), min(cos_air, 1.0), medium.n_air, medium.n_water
    )
    # the light comes along -inwards: it must meet the facet from below, and its reflection stay
    from_below = -dot(inwards, g)
    if from_below <= 0.0 or from_below - 2.0 * cos_water * dot(m, g) >= 0.0:
        return 0.0, d
    through = 1.0 - reflectance(cos_water, cos_air, medium.n_water, medium.n_air)
    if world.target.is_lamp:
        return through * world.interface.foam_transmittance * exposure(d, n, tilt), inwards
    if world.interface.fresnel == FresnelMode.PAPER_BOTH:
        through *= through
    through *= world.interface.foam_transmittance
    through *= (medium.n_air / medium.n_water) ** 2
    through *= from_below * cos_air / (cos_water * -dot(d, g))
    if tilt.x != 0.0 or tilt.y != 0.0:
        through *= exposure(scaled(-1.0, inwards), n, tilt)
    return through, inwards


@inlined
def importance_at(p, lamp, medium):
    """Return the expected score of a path at p, up to a factor.

    Array twin: none, elementary.
    """
    r = norm(minus(lamp, p))
    if r == 0.0:
        return 1.0
    return math.exp(-absorption_path(medium, p.z, lamp.z, r)) / (r * r)
