"""Numbers in the columns of a table, with the best of each marked."""

import math
from collections.abc import Sequence

BEST = " class='fw-best'"


def column_cells(texts: Sequence[str | None], ranked: bool = True) -> list[str]:
    """Cells of a column of numbers as they are shown, as HTML; a dash for None.

    Where less is better (`ranked`), the least is marked, unless all look the same or there is only one.
    """
    different = sorted({text for text in texts if text is not None and not math.isnan(float(text))}, key=float)
    best = different[0] if ranked and len(different) > 1 else None
    return ["<td>–</td>" if text is None else f"<td{BEST if text == best else ''}>{text}</td>" for text in texts]
