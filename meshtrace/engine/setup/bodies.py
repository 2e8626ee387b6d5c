"""The bodies of a link as one mesh, its Embree scene, and its arrays for the kernels."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.setup.arrays import Frame
from meshtrace.kernels.bodies import BodyArrays
from meshtrace.kernels.rays import NO_BVH
from meshtrace.link import Body, Link
from meshtrace.mesh import TriangleMesh


def scene_of(link: Link, frame: Frame) -> EmbreeIntersector | None:
    """Return the scene of all bodies of a link in a frame, None without bodies."""
    # the placed bodies alone decide: links that differ in anything else share a scene
    places = tuple(body.replace(albedo=0.0, reflection="black") for body in link.bodies)
    return _scene(places, frame) if places else None


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


def body_arrays(link: Link, scene: EmbreeIntersector) -> BodyArrays:
    """Return the facets and albedos of the bodies of a link, at its wavelength."""
    bodies, mesh = link.bodies, scene.mesh
    sizes, wavelength = [body.n_facets for body in bodies], link.transmitters[0].wavelength_nm
    return BodyArrays(
        vertices=mesh.vertices,
        faces=mesh.faces,
        face_normals=mesh.face_normals,
        body=np.repeat(np.arange(len(bodies), dtype=np.int32), sizes),
        albedo=np.array([body.albedo_at(wavelength) for body in bodies]),
        is_mirror=np.array([body.reflection == "mirror" for body in bodies]),
        bvh=NO_BVH,
    )
