import { bytesOf } from "../shared/bytes.js";
import { cleared } from "../shared/canvas.js";

// Decodes pictures one at a time, and of those waiting only the latest. `image()` is the last one decoded.
export function makePicture(changed) {
  let busy = false, next = null, image = null;
  function done(decoded) {
    image?.close();
    image = decoded;
    changed();
  }
  async function work(bytes) {
    busy = true;
    try {
      done(bytes.byteLength ? await createImageBitmap(new Blob([bytes])) : null);
    } catch {
      done(null);
    }
    busy = false;
    if (next) [bytes, next] = [next, null], work(bytes);
  }
  return {
    push(view) {
      const bytes = bytesOf(view);
      if (busy) next = bytes;
      else work(bytes);
    },
    busy: () => busy,
    image: () => image,
    close: () => image?.close(),
  };
}

const BRIGHT = 118, MOST = 4; // mean brightness wanted, of 255, and the largest factor

// A CSS filter that brings a dark picture to a middling brightness; empty for one that is bright enough.
export function brightened(image) {
  if (!image) return "";
  const context = new OffscreenCanvas(16, 16).getContext("2d");
  context.drawImage(image, 0, 0, 16, 16);
  const bytes = context.getImageData(0, 0, 16, 16).data.filter((_, k) => k % 4 !== 3);
  const factor = Math.min(BRIGHT / Math.max(bytes.reduce((sum, value) => sum + value, 0) / bytes.length, 1), MOST);
  return factor > 1 ? `brightness(${factor.toFixed(2)})` : "";
}

// Pictures on top of each other, at the position of the first; `layers`: pairs of an image, or null, and its opacity.
export function paintPictures(canvas, room, view, size, layers) {
  const context = cleared(canvas, room);
  if (!size[0]) return;
  const box = [...view.toScreen(-0.5, -0.5), view.scale * size[0], view.scale * size[1]];
  context.imageSmoothingQuality = "medium";
  for (const [image, opacity] of layers) {
    if (!image) continue;
    // From six screen pixels per picture pixel on, users want to see individual pixels.
    context.imageSmoothingEnabled = (view.scale * size[0]) / image.width < 6;
    context.globalAlpha = opacity;
    context.drawImage(image, ...box);
  }
}
