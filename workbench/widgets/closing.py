"""Closing widgets with all that belongs to them.

ipywidgets keeps each widget, and its place in the browser, until it is closed itself. What its callbacks know lives on
with it. Closing a box closes neither what stands in it nor its layout.
"""

from collections.abc import Iterator, Sequence

import ipywidgets as widgets

from workbench.widgets.kernel_comms import lose_no_messages

OURS = __name__.rpartition(".")[0]
"""The package whose objects are looked into; sessions and models hold no widgets."""


def close_all_of(root: object) -> None:
    """Close the widgets of a widget, or of another object of this package: in its boxes, attributes and lists."""
    parts = list(widgets_of(root))
    if any(part.comm is not None for part in parts):
        lose_no_messages()  # to pages, too, that were opened later than the widgets
    for part in parts:
        widgets.Widget.close(part)  # what else its class does for closing has been done by whoever made it


def refill(box: widgets.Box, children: Sequence[widgets.Widget]) -> None:
    """Show other widgets in a box, and close those that were in it."""
    before = box.children
    box.children = tuple(children)
    for child in before:
        close_all_of(child)


def widgets_of(root: object) -> Iterator[widgets.Widget]:
    """The widgets of an object, each once; a box comes before what stands in it."""
    seen: dict[int, object] = {}
    waiting = [root]
    while waiting:
        found = waiting.pop()
        if id(found) in seen:
            continue
        seen[id(found)] = found  # kept, so that no other object gets its number
        if isinstance(found, widgets.Widget):
            yield found
            waiting += [getattr(found, name) for name in found.trait_names() if found.trait_has_value(name)]
        elif isinstance(found, list | tuple | set):
            waiting += found
        elif isinstance(found, dict):
            waiting += found.values()
        if any(kind.__module__.startswith(OURS) for kind in type(found).__mro__):
            waiting += list(getattr(found, "__dict__", {}).values())
