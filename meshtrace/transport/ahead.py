"""Compilation of the kernels that evaluate chains over a surface, without chains."""

from __future__ import annotations

from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.transport.aimed import AimedChains
from meshtrace.transport.chain_sets import ChainDrawer, Request
from meshtrace.transport.forced_link import forced_link


def compile_evaluation(link: Link, mesh: TriangleMesh, normals: str = "vertex") -> None:
    """Compile the kernels that evaluate chains of a link over a mesh, in the order of their use.

    Those that draw chains take as long to compile: a second process can take its share.

    Parameters
    ----------
    link, mesh
        Link and surface of a later run, which choose between the kernels.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.

    Raises
    ------
    Refused
        If forced detection does not follow the link.
    """
    arrays = forced_link(link)
    none = ChainDrawer(arrays, 0.0, 0.0).empty(Request(source=0, order=1, per_shift=0, key=()))
    aimed = AimedChains(arrays, mesh, None, normals, link.physics.unresolved)
    aimed.direct_gains(0, 0)
    aimed.score(0, 0, none)
