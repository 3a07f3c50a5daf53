"""One colour scale of residuals for the picture, the strip and the head of a panel."""

from collections.abc import Callable

from workbench.widgets.overlay_view import OverlayView
from workbench.widgets.timeline_view import TimelineView


class SharedScale:
    """Keeps the ends of the colour scales alike while all show percent; `redraw` is called when the end changed.

    The user drags it in the picture or at the strip. Until then it is that of the strip, so that colours mean the same
    in every frame.
    """

    def __init__(
        self, picture: OverlayView, strip: TimelineView, percent: Callable[[], bool], redraw: Callable[[], None]
    ) -> None:
        self._picture, self._strip, self._percent, self._redraw = picture, strip, percent, redraw
        self._has_run = False
        for one, other in ((picture, strip), (strip, picture)):
            one.observe(lambda change, other=other: self._on_end(other, change["new"]), "scale_max")
        picture.observe(lambda _change: self._on_unit(), "unit")

    @property
    def end(self) -> float:
        """Residual at the bright end, % of the eye distance."""
        return self._picture.scale if self._percent() else self._strip.scale

    def show_run(self) -> None:
        """Follow the strip of a new run."""
        self._has_run = True
        self._follow()

    def _follow(self) -> None:
        self._picture.scale_with(self._strip.scale if self._has_run and self._percent() else None)

    def _on_unit(self) -> None:
        # An end in percent says nothing about pixels, nor one in pixels about the strip, which stays in percent.
        self._follow()
        self._picture.scale_max = self._strip.scale_max if self._percent() else 0.0

    def _on_end(self, other: OverlayView | TimelineView, end: float) -> None:
        if self._percent() and other.scale_max != end:
            other.scale_max = end
        self._redraw()
