"""Identifies the mouse drag that moves a slider, so that a slow drag is one undo step."""

import anywidget
import traitlets

WATCH = """
function render({ model, el }) {
  el.style.display = "none";
  const tell = (drag) => {
    if (model.get("drag") === drag) return;
    model.set("drag", drag);
    model.save_changes();
  };
  // In the capture phase, so that the number is sent before the slider's first value.
  const onPress = (event) => {
    const slider = event.target instanceof Element && event.target.closest(".noUi-target");
    tell(slider ? Math.round(performance.timeOrigin + event.timeStamp) : 0);
  };
  const onKey = () => tell(0);
  document.addEventListener("pointerdown", onPress, true);
  document.addEventListener("keydown", onKey, true);
  return () => {
    document.removeEventListener("pointerdown", onPress, true);
    document.removeEventListener("keydown", onKey, true);
  };
}
export default { render };
"""


class DragWatch(anywidget.AnyWidget):
    """An invisible widget. `drag` numbers the latest drag of any slider in the page; 0 after a key or another click.

    Values throttled by the browser arrive after the mouse is released, so the end of a drag is unknown: it lasts until
    the next one begins.
    """

    _esm = WATCH
    drag = traitlets.Int(0).tag(sync=True)
