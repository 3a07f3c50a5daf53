"""Cut the head out of the base mesh and give it a mirror-symmetric triangulation and named regions.

The cut follows the seams of the UV islands: the island of the face, the islands of its cavities (mouth, eye sockets)
and `RINGS` rings of quads below the neck seam. That leaves one clean 48-edge border loop; a plane cut would be ragged.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from makehuman import BaseMesh, MakeHuman
from scipy import sparse

RINGS = 4
FACE_ISLAND_MIDDLE_V = 0.4831627
"""The midline of the face in MakeHuman's atlas, where the face lies on its side."""
PARTS = {
    "skin": "body",
    "eyeL": "helper-l-eye",
    "eyeR": "helper-r-eye",
    "teethU": "helper-upper-teeth",
    "teethL": "helper-lower-teeth",
    "tongue": "helper-tongue",
}
REGIONS = (*PARTS, "mouth_cavity", "eye_cavity", "lips", "brow", "scalp")


@dataclass(frozen=True)
class Crop:
    """The head as an index set into the base mesh; all indices below are crop indices unless named base."""

    base_ids: Int[np.ndarray, "v"]
    """base.obj vertex id (0-based) of every crop vertex, ascending."""
    quads: Int[np.ndarray, "q 4"]
    uv_quads: Int[np.ndarray, "q 4"]
    uvs: Float[np.ndarray, "u 2"]
    mirror: Int[np.ndarray, "v"]
    part: Int[np.ndarray, "v"]
    """Index into PARTS."""
    quad_part: Int[np.ndarray, "q"]
    quad_island: Int[np.ndarray, "q"]
    """UV island of every quad."""
    outer: Bool[np.ndarray, "v"]
    """Skin seen from outside, including the seams to the cavities."""
    mouth_cavity: Bool[np.ndarray, "v"]
    eye_cavity: Bool[np.ndarray, "v"]
    lip_seam: Int[np.ndarray, "k"]
    lid_seam_left: Int[np.ndarray, "j"]
    lid_seam_right: Int[np.ndarray, "j"]
    lip_mask: Float[np.ndarray, "v"]
    """Painted lip coverage, 0..1."""

    def is_part(self, *names: str) -> Bool[np.ndarray, "v"]:
        """Vertices that belong to any of the named parts."""
        return np.isin(self.part, [list(PARTS).index(name) for name in names])

    def mirrored(self, field: Float[np.ndarray, "*batch v 3"]) -> Float[np.ndarray, "*batch v 3"]:
        """The field reflected at the midplane: values move to the mirror vertex and x changes sign."""
        return field[..., self.mirror, :] * np.array([-1.0, 1.0, 1.0])

    def symmetrised(self, field: Float[np.ndarray, "*batch v 3"]) -> Float[np.ndarray, "*batch v 3"]:
        """Average of a field and its mirror image, so exactly equal to its own mirror image."""
        return 0.5 * (field + self.mirrored(field))


def cut_head(source: MakeHuman) -> Crop:
    """Select the parts, reindex vertices and UVs, and name the cavities and their seams."""
    base = source.base
    islands = uv_islands(base)
    face, cavities = head_islands(base, islands)
    chosen = {name: base.groups == group for name, group in PARTS.items()}
    chosen["skin"] = _grown(base, np.isin(islands, [face, *cavities]) & chosen["skin"], RINGS)
    rows = np.concatenate([np.flatnonzero(mask) for mask in chosen.values()])
    quad_part = np.concatenate([np.full(mask.sum(), i) for i, mask in enumerate(chosen.values())])

    base_ids, quads = np.unique(base.quads[rows], return_inverse=True)
    uv_ids, uv_quads = np.unique(base.quad_uvs[rows], return_inverse=True)
    quads, uv_quads = quads.reshape(-1, 4), uv_quads.reshape(-1, 4)
    part = np.zeros(len(base_ids), int)
    part[quads] = quad_part[:, None]

    def vertices_of(quad_mask: np.ndarray) -> np.ndarray:
        mask = np.zeros(len(base_ids), bool)
        mask[quads[quad_mask]] = True
        return mask

    quad_island = islands[rows]
    inside = [vertices_of(quad_island == island) for island in cavities]
    outer = vertices_of((quad_part == 0) & ~np.isin(quad_island, cavities))
    centres = [base.vertices[base_ids[mask]].mean(axis=0) for mask in inside]
    mouth = int(np.argmin([centre[1] for centre in centres]))
    left = int(np.argmax([centre[0] for centre in centres]))
    right = int(np.argmin([centre[0] for centre in centres]))
    uv_of_vertex = np.zeros((len(base_ids), 2))
    uv_of_vertex[quads] = base.uvs[base.quad_uvs[rows]]
    lips = np.where((part == 0) & ~(inside[mouth] & ~outer), lip_coverage(source, uv_of_vertex), 0.0)
    mirror = np.searchsorted(base_ids, base.mirror[base_ids])
    return Crop(
        base_ids=base_ids,
        quads=quads,
        uv_quads=uv_quads,
        uvs=base.uvs[uv_ids],
        mirror=mirror,
        part=part,
        quad_part=quad_part,
        quad_island=quad_island,
        outer=outer,
        mouth_cavity=inside[mouth] & ~outer,
        eye_cavity=(inside[left] | inside[right]) & ~outer,
        lip_seam=np.flatnonzero(inside[mouth] & outer),
        lid_seam_left=np.flatnonzero(inside[left] & outer),
        lid_seam_right=np.flatnonzero(inside[right] & outer),
        lip_mask=0.5 * (lips + lips[mirror]),
    )


def lip_coverage(source: MakeHuman, uvs: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k"]:
    """MakeHuman's lip mask at UV points of the face island, averaged with its mirror image across the island."""
    across = uvs * [1.0, -1.0] + [0.0, 2 * FACE_ISLAND_MIDDLE_V]
    return 0.5 * (source.mask("lips", uvs) + source.mask("lips", across))


def triangulate(
    crop: Crop, vertices: Float[np.ndarray, "v 3"]
) -> tuple[Int[np.ndarray, "t 3"], Int[np.ndarray, "t 3"]]:
    """Split every quad along its shorter diagonal, mirrored quads along mirrored diagonals.

    Returns vertex triangles and UV triangles, both (2 q, 3), in quad order. The midline runs along quad edges, so no
    quad is its own mirror image and the rule is always consistent.
    """
    quads, uv_quads = crop.quads, crop.uv_quads
    rows = {tuple(sorted(quad)): row for row, quad in enumerate(quads.tolist())}
    partner = np.array([rows[tuple(sorted(quad))] for quad in crop.mirror[quads].tolist()])
    first = np.minimum(np.arange(len(quads)), partner)
    # Decide on one quad of each pair, then find the same vertex pair in the other one.
    corner = vertices[quads[first]]
    shorter = np.linalg.norm(corner[:, 0] - corner[:, 2], axis=1) <= np.linalg.norm(corner[:, 1] - corner[:, 3], axis=1)
    ends = np.where(shorter[:, None], quads[first][:, [0, 2]], quads[first][:, [1, 3]])
    ends = np.where((first == np.arange(len(quads)))[:, None], ends, crop.mirror[ends])
    even = (quads[:, [0, 2]][:, :, None] == ends[:, None, :]).any(axis=2).all(axis=1)
    split = np.where(even[:, None, None], [[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]])
    take = np.arange(len(quads))[:, None, None]
    return quads[take, split].reshape(-1, 3), uv_quads[take, split].reshape(-1, 3)


def region_ids(crop: Crop, brow: np.ndarray, scalp: np.ndarray) -> np.ndarray:
    """Index into REGIONS for every vertex; `brow` and `scalp` are paint coverages 0..1."""
    regions = crop.part.astype(np.uint8)
    skin = crop.is_part("skin")
    coverage = {
        "scalp": scalp > 0.5,
        "brow": brow > 0.3,
        "lips": crop.lip_mask > 0.5,
        "mouth_cavity": crop.mouth_cavity,
        "eye_cavity": crop.eye_cavity,
    }
    for name, mask in coverage.items():
        regions[mask & skin] = REGIONS.index(name)
    return regions


def uv_islands(base: BaseMesh) -> np.ndarray:
    """Connected component id, in UV index space, of every quad."""
    edges = np.concatenate([base.quad_uvs[:, [i, (i + 1) % 4]] for i in range(4)])
    graph = sparse.coo_matrix((np.ones(len(edges)), edges.T), shape=(len(base.uvs),) * 2)
    return sparse.csgraph.connected_components(graph, directed=False)[1][base.quad_uvs[:, 0]]


def head_islands(base: BaseMesh, islands: np.ndarray) -> tuple[int, list[int]]:
    """The UV island of the nose tip, and the islands of the cavities that open into it."""
    body = base.groups == "body"
    candidates = base.group_vertices("body")
    candidates = candidates[base.vertices[candidates, 1] > 6.5]
    tip = candidates[np.argmax(base.vertices[candidates, 2])]
    face = int(islands[body & (base.quads == tip).any(axis=1)][0])
    face_vertices = np.unique(base.quads[body & (islands == face)])
    cavities = []
    for island in np.unique(islands[body]):
        own = np.unique(base.quads[body & (islands == island)])
        touching = np.isin(own, face_vertices).sum()
        if island != face and touching >= 20 and base.vertices[own, 1].min() > 6.0:
            cavities.append(int(island))
    return face, cavities


def _grown(base: BaseMesh, mask: np.ndarray, rings: int) -> np.ndarray:
    """The quads of `mask` plus the given number of rings of body quads that touch it."""
    for _ in range(rings):
        touched = np.zeros(len(base.vertices), bool)
        touched[base.quads[mask]] = True
        mask = (base.groups == "body") & (mask | touched[base.quads].any(axis=1))
    return mask
