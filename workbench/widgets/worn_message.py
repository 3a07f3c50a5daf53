"""Messages that describe to the browser what a character wears; see `drawing/worn.js`."""

import io

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from workbench.face.dressed_head import DressedHead, WornPart
from workbench.pictures.finish import FINISHES
from workbench.pictures.mesh import split_seams

PICTURE_QUALITY = 88
MASK, BLEND, MIXED = "mask", "blend", "mixed"
WAYS = {"corneas": "glint", "brows": BLEND, "lashes": BLEND, "clothes": MASK, "hair": MIXED}
"""How alpha is used, opaque if not named: cut out, blended, or the solid core cut out and its edge blended."""


def worn_message(worn: WornPart) -> dict[str, object]:
    """A part: ties to the head's vertices, points along its seams, triangles and picture."""
    part, finish = worn.part, FINISHES[worn.part.kind]
    order, uv_of_point, drawn = split_seams(part.triangles, part.triangles_uv)
    return {
        "kind": part.kind,
        "still": part.still,
        "vertices": len(part.offsets),
        "anchors": part.anchors.astype("<u4").tobytes(),
        "weights": part.weights.astype("<f4").tobytes(),
        "offsets": part.offsets.astype("<f4").tobytes(),
        "triangles": part.triangles.astype("<u4").tobytes(),
        "drawn": drawn.astype("<u4").tobytes(),
        "order": order.astype("<u4").tobytes(),
        "uv": (part.uv[uv_of_point] * [1.0, -1.0] + [0.0, 1.0]).astype("<f4").tobytes(),
        "shade": part.shade.tobytes(),
        "picture": _webp(worn.picture),
        "way": WAYS.get(part.kind, "opaque"),
        "shine": list(finish.shine),
        "roundness": finish.roundness,
    }


def person_message(dressed: DressedHead, rest: Float[np.ndarray, "v 3"]) -> dict[str, object]:
    """The person whom parts are on: vertices without an expression, and the size beside the mean head."""
    return {"rest": rest.astype("<f4").tobytes(), "growth": dressed.growth(rest).tolist()}


def _webp(picture: UInt8[np.ndarray, "h w 4"]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "WEBP", quality=PICTURE_QUALITY, exact=True)
    return stream.getvalue()
