// Numbers the drags of sliders, so that a slow drag is one undo step; 0 after a key or another press.
export function watchDrags(model) {
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
