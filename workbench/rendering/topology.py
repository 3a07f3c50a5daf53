"""What a renderer needs to know about a triangle mesh besides its vertices; made once per mesh."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from workbench.arrays import AnyArray
from workbench.errors import InputError


class MeshTopology(NamedTuple):
    """Triangles, edges and neighbourhoods as arrays of fixed size."""

    triangles: Int[AnyArray, "t 3"]
    """Counter-clockwise seen from outside."""
    edges: Int[AnyArray, "e 2"]
    """The two half-edges 3·triangle + corner of each edge, running from that corner to the next; the second is −1 at
    the border of an open mesh."""
    faces_of_vertex: Int[AnyArray, "v n"]
    """The triangles around each vertex, padded with the number of triangles."""
    part: Int[AnyArray, "t"]
    """3 · the connected part of the mesh + the side of a slit (0: neither, 1 and 2) of each triangle."""


def mesh_topology(
    triangles: Integer[np.ndarray, "t 3"], vertex_count: int, sides: Integer[np.ndarray, "t"] | None = None
) -> MeshTopology:
    """The topology of a mesh. Edges of more than two triangles count as borders of each.

    `sides` marks the two sides of slits, as upper and lower lip, by 1 and 2 and all else by 0: like separate parts,
    they may press into each other. Raises `InputError` if a triangle names a vertex that does not exist, there is no
    triangle, or the sides are not one of 0, 1, 2 for each.
    """
    triangles = np.asarray(triangles).astype(np.int32)
    if len(triangles) == 0 or triangles.min() < 0 or triangles.max() >= vertex_count:
        raise InputError(
            f"A mesh to render needs triangles between its {vertex_count} vertices; "
            "its triangle list is empty or names another vertex."
        )
    sides = np.zeros(len(triangles), np.int32) if sides is None else np.asarray(sides).astype(np.int32)
    if sides.shape != (len(triangles),) or not np.isin(sides, (0, 1, 2)).all():
        raise InputError(f"The sides of slits are 0, 1 or 2 for each of {len(triangles)} triangles; check the array.")
    part = 3 * _parts(triangles, vertex_count) + sides
    return MeshTopology(triangles, _edges(triangles), _faces_of_vertex(triangles, vertex_count), part)


def may_cross(part: Int[AnyArray, "*#n"], other: Int[AnyArray, "*#n"]) -> Bool[AnyArray, "*#n"]:
    """Whether triangles of these parts are apart, so that a line between them is where they pass through each other."""
    return (part // 3 != other // 3) | ((part % 3) * (other % 3) == 2)


def face_normals(vertices: Float[AnyArray, "v 3"], triangles: Int[AnyArray, "t 3"]) -> Float[AnyArray, "t 3"]:
    """Outward normals, twice as long as the triangles' areas."""
    corners = vertices[triangles]
    return jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def vertex_normals(vertices: Float[AnyArray, "v 3"], topology: MeshTopology) -> Float[AnyArray, "v 3"]:
    """Unit outward normals, averaged over the triangles around each vertex by area."""
    normals = face_normals(vertices, topology.triangles)
    padded = jnp.concatenate([normals, jnp.zeros((1, 3), normals.dtype)])
    return unit(padded[topology.faces_of_vertex].sum(axis=1))


def unit(vectors: Float[AnyArray, "*n 3"]) -> Float[AnyArray, "*n 3"]:
    """Vectors of length 1; zero stays zero, with a finite derivative."""
    return vectors / jnp.sqrt(jnp.maximum(jnp.sum(vectors * vectors, axis=-1, keepdims=True), 1e-20))


def _edges(triangles: Int[np.ndarray, "t 3"]) -> Int[np.ndarray, "e 2"]:
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    order = np.lexsort(ends.T)
    _, first, uses = np.unique(ends[order], axis=0, return_index=True, return_counts=True)
    pairs = np.stack([order[first[uses == 2]], order[first[uses == 2] + 1]], axis=1)
    lone = np.isin(np.arange(len(order)), pairs.ravel(), invert=True).nonzero()[0]
    borders = np.stack([lone, np.full_like(lone, -1)], axis=1)
    return np.concatenate([pairs, borders]).astype(np.int32)


def _faces_of_vertex(triangles: Int[np.ndarray, "t 3"], vertex_count: int) -> Int[np.ndarray, "v n"]:
    corners = triangles.ravel()
    order = np.argsort(corners, kind="stable")
    uses = np.bincount(corners, minlength=vertex_count)
    place = np.arange(len(order)) - np.repeat(np.cumsum(uses) - uses, uses)
    table = np.full((vertex_count, max(1, uses.max())), len(triangles), np.int32)
    table[corners[order], place] = order // 3
    return table


def _parts(triangles: Int[np.ndarray, "t 3"], vertex_count: int) -> Int[np.ndarray, "t"]:
    ends = triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    links = coo_matrix((np.ones(len(ends), bool), ends.T), shape=(vertex_count, vertex_count))
    return connected_components(links, directed=False)[1][triangles[:, 0]].astype(np.int32)
