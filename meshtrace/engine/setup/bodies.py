"""The bodies of a link as one mesh, its Embree scene, and its arrays for the kernels."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.setup.arrays import Frame
from meshtrace.kernels.bodies import BodyArrays
from meshtrace.kernels.rays import NO_BVH
from meshtrace.link import Body, Link
from meshtrace.mesh import TriangleMesh


class BodyScene(NamedTuple):
    """All bodies of a link in a frame."""

    intersector: EmbreeIntersector
    arrays: BodyArrays  # with the albedos at the wavelength of the link


def scene_of(link: Link, frame: Frame) -> BodyScene | None:
    """Return the scene of all bodies of a link in a frame, None without bodies."""
    if not link.bodies:
        return None
    # the placed bodies alone decide: links that differ in anything else share a scene
    places = tuple(body.replace(albedo=0.0, reflection="black") for body in link.bodies)
    intersector = _scene(places, frame)
    bodies, mesh = link.bodies, intersector.mesh
    sizes, wavelength = [body.n_facets for body in bodies], link.transmitters[0].wavelength_nm
    arrays = BodyArrays(
        vertices=mesh.vertices,
        faces=mesh.faces,
        face_normals=mesh.face_normals,
        body=np.repeat(np.arange(len(bodies), dtype=np.int32), sizes),
        albedo=np.array([body.albedo_at(wavelength) for body in bodies]),
        is_mirror=np.array([body.reflection == "mirror" for body in bodies]),
        bvh=NO_BVH,
    )
    return BodyScene(intersector, arrays)


@contextmanager
def for_thread(scene: BodyScene | None) -> Iterator[BodyArrays | None]:
    """Yield the arrays of bodies with a function of Embree for kernels of one thread."""
    if scene is None:
        yield None
        return
    with scene.intersector.function() as bvh:
        yield scene.arrays._replace(bvh=bvh)


@lru_cache(maxsize=2)  # tuned: a million facets take a second to build, and 200 MB
def _scene(bodies: tuple[Body, ...], frame: Frame) -> EmbreeIntersector:
    """Return the scene of bodies in a frame."""
    vertices, faces, start = [], [], 0
    for body in bodies:
        points, corners = body.triangles()
        vertices.append(frame.points(points))
        faces.append(corners + np.int32(start))
        start += len(points)
    mesh = TriangleMesh(np.concatenate(vertices), np.concatenate(faces), overhangs=True)
    # built here: threads that cast the first rays at once would each build it
    return EmbreeIntersector(mesh, 1).built()
