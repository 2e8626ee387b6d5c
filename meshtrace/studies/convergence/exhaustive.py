"""Forced detection that asks every facet for crossings."""

from __future__ import annotations

from meshtrace.bvh import EmbreeIntersector
from meshtrace.kernels.aiming import Target
from meshtrace.kernels.chain_gain import Search
from meshtrace.mesh import TriangleMesh
from meshtrace.transport.forced import ForcedDetection, _Aimed


class ExhaustiveDetection(ForcedDetection):
    """Forced detection without the lot that decides which chains are searched thoroughly.

    Where Newton misses a crossing of a mesh, the usual estimator finds it in a share of the
    chains and counts it the more often: unbiased, but noise that common chains do not share.
    """

    def _over(self, mesh: TriangleMesh, intersector: EmbreeIntersector | None = None) -> _Aimed:
        return _ExhaustivelyAimed(self, mesh, intersector)


class _ExhaustivelyAimed(_Aimed):
    def _search(self, target: Target) -> Search:
        return super()._search(target)._replace(audit=1.0)
