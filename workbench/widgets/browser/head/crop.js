// The part of the picture that the panel's photo shows: its scale, place and the size of its stage; null without one.
export function cropOf(canvas) {
  const state = canvas.closest(".fw-panel")?.querySelector(".fw-overlay")?.dataset.state;
  if (!state) return null;
  const { scale, x, y, room: [width, height] } = JSON.parse(state);
  return { scale, x, y, width, height };
}

// The camera (focal lengths, principal point) of a head of this size that is seen through the picture's lens, with the
// photo's crop about the middle and, on a stage as high as the photo's, its zoom.
export function throughCrop([fx, fy, cx, cy], { scale, x, y, width, height }, [wide, high]) {
  const zoom = high / height, by = scale * zoom;
  return [fx * by, fy * by, zoom * (scale * cx + x - width / 2) + wide / 2, zoom * (scale * cy + y - height / 2) + high / 2];
}
