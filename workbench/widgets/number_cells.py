"""Numbers in the columns of a table, with the best of each marked."""

import math
from collections.abc import Sequence

BEST = " class='fw-best'"


def column_cells(texts: Sequence[str | None], ranked: bool = True) -> list[str]:
    """Cells of a column of numbers as they are shown, as HTML; a dash for None.

    Where less is better (`ranked`), the least is marked, unless all look the same or there is only one.
    """
    numbers = [math.nan if text is None else float(text) for text in texts]
    different = {number for number in numbers if not math.isnan(number)}
    best = min(different) if ranked and len(different) > 1 else None
    return [
        "<td>–</td>" if text is None else f"<td{BEST if number == best else ''}>{text}</td>"
        for text, number in zip(texts, numbers, strict=True)
    ]
