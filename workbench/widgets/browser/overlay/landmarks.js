const COLUMNS = 8; // of the table of landmarks: observed x y, model x y, value, distance in px, confidence, weight
const TRUST_MS = 2000; // a moved landmark stays where the user put it until the kernel confirms, or for this time
const REACH = 10; // largest distance in screen pixels between the pointer and the landmark it selects

// The landmarks of a fit. One moved by the user stays where they put it until the kernel sends it back.
export function makeLandmarks(changed) {
  const moved = new Map(); // landmark -> {x, y, until}
  let fit = null;
  const number = (i, column) => fit[COLUMNS * i + column];
  const confirmed = (i, spot) => fit && Math.hypot(number(i, 0) - spot.x, number(i, 1) - spot.y) < 0.05;

  return {
    read(bytes) {
      fit = bytes.byteLength ? new Float32Array(bytes) : null;
      for (const [i, spot] of moved) if (confirmed(i, spot) && spot.until < Infinity) moved.delete(i);
    },
    found: () => fit !== null,
    count: () => (fit ? fit.length / COLUMNS : 0),
    detected: (i) => [number(i, 0), number(i, 1)],
    observed: (i) => (moved.has(i) ? [moved.get(i).x, moved.get(i).y] : [number(i, 0), number(i, 1)]),
    projected: (i) => [number(i, 2), number(i, 3)],
    value: (i) => number(i, 4),
    distance: (i) => number(i, 5),
    confidence: (i) => number(i, 6),
    weight: (i) => number(i, 7),

    hold: (i, x, y) => moved.set(i, { x, y, until: Infinity }),
    drop(i, x, y) {
      const until = performance.now() + TRUST_MS;
      moved.set(i, { x, y, until });
      setTimeout(() => moved.get(i)?.until === until && (moved.delete(i), changed()), TRUST_MS);
    },
    release: (i) => moved.delete(i),
    releaseAll: () => moved.clear(),
  };
}

export const indices = (landmarks) => Array.from({ length: landmarks.count() }, (_, i) => i);

// The landmark under the pointer, -1 if none; `shown`: whether detections and the model's landmarks count.
export function hit(landmarks, toScreen, [x, y], shown) {
  let best = -1, least = REACH;
  for (const i of indices(landmarks)) {
    const places = [shown.observed ? landmarks.observed(i) : null, shown.model ? landmarks.projected(i) : null];
    for (const spot of places.filter(Boolean)) {
      const [sx, sy] = toScreen(...spot), distance = Math.hypot(sx - x, sy - y);
      if (distance < least) [best, least] = [i, distance];
    }
  }
  return best;
}

export function insidePolygon([x, y], corners) {
  let inside = false;
  for (let i = 0, j = corners.length - 1; i < corners.length; j = i++) {
    const [xi, yi] = corners[i], [xj, yj] = corners[j];
    if (yi > y !== yj > y && x < ((xj - xi) * (y - yi)) / (yj - yi) + xi) inside = !inside;
  }
  return inside;
}
