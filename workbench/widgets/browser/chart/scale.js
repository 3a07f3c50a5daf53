export const LEFT = 54, RIGHT = 12, TOP = 18, BOTTOM = 30; // pixels around the plot

// Index of the value closest to `wanted` in an ascending array.
export function nearest(values, wanted) {
  let low = 0, high = values.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] <= wanted) low = middle;
    else high = middle;
  }
  return Math.abs(values[high] - wanted) < Math.abs(values[low] - wanted) ? high : low;
}

// Smallest and largest value that can be drawn; on a logarithmic axis their exponents.
function extent(rows, log) {
  let low = Infinity, high = -Infinity, zeros = false;
  for (const row of rows) {
    for (const value of row) {
      if (log && value <= 0) zeros = true;
      if (!Number.isFinite(value) || (log && value <= 0)) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (low > high) [low, high] = log ? [0.1, 1] : [0, 1];
  if (log) {
    [low, high] = [Math.log10(low), Math.log10(high)];
    low = Math.max(low, high - 14); // below that there are only rounding errors
  }
  return { low, high, zeros };
}

// The ranges of the axes: `low` and `high` (exponents on a logarithmic axis), `left` and `right`.
export function rangeOf(x, rows, log) {
  const { low, high, zeros } = extent(rows, log), room = high - low || Math.abs(high) * 0.1 || 1;
  const first = x.length ? x[0] : 0, last = x.length ? x[x.length - 1] : 1, half = first === last ? 0.5 : 0;
  return {
    low: low - (zeros ? 0.15 : 0.06) * room, high: high + 0.06 * room, left: first - half, right: last + half, zeros,
  };
}

// Positions of values in a plot of width × height pixels. Made once per drawing, because asking the page for every
// point would take most of the time.
export function scaleOf(range, width, height, log) {
  // Zero has no logarithm, so it is drawn on the lower edge.
  const level = (value) => (log ? (value > 0 ? Math.max(Math.log10(value), range.low) : range.low) : value);
  const toLevel = (place) => TOP + height * (1 - (place - range.low) / (range.high - range.low));
  return {
    range, width, height, log, toLevel,
    right: LEFT + width, bottom: TOP + height,
    toX: (value) => LEFT + ((value - range.left) / (range.right - range.left)) * width,
    fromX: (place) => range.left + ((place - LEFT) / width) * (range.right - range.left),
    toY: (value) => toLevel(level(value)),
  };
}
