"""Unscattered light on the cells of a map, for the first receiver of a link."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from scipy.ndimage import uniform_filter

from meshtrace.engine.chains import microfacets, unscattered
from meshtrace.engine.chains.aimed import LEAST_ERROR, LEAST_IMAGE_ERROR, AimedChains, gauss_rules
from meshtrace.engine.chains.cells import Cells, blurred_map, image_map
from meshtrace.engine.chains.gain import Colours
from meshtrace.engine.setup.arrays import locator
from meshtrace.engine.setup.ends import forced_link, require_height_field
from meshtrace.engine.setup.options import IrradianceMap
from meshtrace.engine.setup.tinting import UNTINTED, Tinting
from meshtrace.errors import Refused
from meshtrace.kernels.scene import Emitter, Target
from meshtrace.kernels.tints import ALONE
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link, Receiver, WaterSource
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map

# Most nodes along an edge of a cell to resolve the blur by random slopes: 16^2 nodes a cell take as
# long as sampled chains.
_COARSEST = 16


def unscattered_map(
    link: Link,
    mesh: TriangleMesh,
    grid: IrradianceMap,
    normals: str = "vertex",
    threads: int = 1,
    tinting: Tinting = UNTINTED,
    lengths: tuple[float, float] = (1.0, 2.0),
) -> tuple[Floats, Floats] | None:
    """Return the unscattered gains of the first receiver at each cell, and their errors.

    Shapes (n, n, wavelengths), x and y rising; the receiver keeps its height, area and view. The
    `lengths` of parts of facets are over the usual one: the first gives the gain, the change by the
    second its error (see `AimedChains.relative_error`).

    Light counts that crosses the surface once, at its first arrival, and meets nothing else. None
    where it has to be sampled: for extended sources, light from the air, receivers in the water or
    tilted, overhanging surfaces, bodies, random slopes too narrow for the cells, and some forms as
    published.
    """
    receiver = link.receivers[0]
    upright = isinstance(receiver, Receiver) and receiver.tilt_deg == 0.0
    points = all(isinstance(t, WaterSource) and t.size == 0.0 for t in link.transmitters)
    if not (upright and points) or link.physics.fov != "angle" or link.bodies:
        return None
    # cells start at -extent; a last one may reach beyond +extent, which moves the middle
    middle = 0.5 * grid.n * grid.step - grid.extent
    link = link.replace(receiver=receiver.replace(position=(middle, middle)))
    try:
        require_height_field(mesh)
        arrays = forced_link(link)
    except Refused:
        return None
    aimed = AimedChains(arrays, mesh, normals, link.physics.unresolved)
    # axes of the aperture along those of the cells
    target = arrays.targets[0]._replace(e1=Vec3(1.0, 0.0, 0.0), e2=Vec3(0.0, 1.0, 0.0))
    # bins over all of the mesh: those of one receiver hold the facets that it sees alone
    aimed.locator = locator(aimed.surface, [target._replace(reach=math.inf)])
    step = grid.step / arrays.frame.unit
    cells = Cells(-0.5 * grid.n * step, -0.5 * grid.n * step, step, grid.n)
    total, longer = np.zeros((2, grid.n, grid.n, len(tinting.shares)))
    image = partial(_image, aimed, target, cells, tinting)
    # both lengths of parts in one queue: threads share them
    jobs = [(emitter, length) for emitter in arrays.emitters for length in lengths]
    images = ordered_map(lambda job: image(*job), jobs, threads)
    for power in arrays.power:
        for gain in (total, longer):
            cell_gains = next(images)
            if cell_gains is None:
                return None
            # a cell stands for the aperture: light per area, times the area of the aperture
            gain += power * target.area / step**2 * cell_gains
    least = LEAST_ERROR if aimed.rough else LEAST_IMAGE_ERROR
    # Errors of both signs, as those at the rim of a view, may cancel in a cell: average the squares
    # over its neighbours, too. At the rim errors are of first order over random slopes, so that the
    # whole change is taken.
    square = uniform_filter((longer - total) ** 2, (3, 3, 0), mode="nearest")
    square[(total == 0.0) & (longer == 0.0)] = 0.0  # dark: no part lands there
    # running sums may round below zero
    return total, np.maximum(np.sqrt(np.maximum(square, 0.0)), least * total)


def _image(
    aimed: AimedChains, target: Target, cells: Cells, tinting: Tinting, emitter: Emitter,
    longer: float,
) -> Floats | None:  # fmt: skip
    """Return the gain (n, n, wavelengths) of apertures as large as cells.

    None: light has to be sampled. Parts of facets are `longer` times as long as usual.
    """
    scene = aimed.scene(emitter, target)
    n_colours, n_tints = tinting.shares.shape
    gain = np.zeros((cells.n, cells.n, n_colours))
    colours = Colours(
        tints=tinting.tints,
        mixture=tinting._replace(bases=()).mixture(0, ALONE.parts),
        clear=aimed.clear,
        log_weights=np.zeros(n_tints),
        factors=np.empty((2, n_colours)),
    )
    stretch, lever, bend = aimed.bounds_of(scene)
    if not aimed.rough:
        # a triangle clipped by the four edges of a cell has seven corners: 16 are enough
        stack, polygons = np.empty((unscattered.STACK, 3), np.int64), np.empty((2, 16, 2))
        image_map(scene, cells, longer, 1.5 * stretch, lever, bend, stack, polygons, colours, gain)
        return gain
    blur = aimed.blur(scene)
    # one point along a cell for each standard deviation of the light
    across = math.ceil(cells.step / blur) if blur > 0.0 else _COARSEST + 1
    if not aimed.blurred or across > _COARSEST:
        return None
    most, rules = microfacets.MOST_PARTS, gauss_rules(_COARSEST)
    whole = blurred_map(scene, cells, longer, stretch, most, across, rules, colours, gain)
    return gain if whole else None
