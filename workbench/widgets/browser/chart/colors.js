const DASHES = [[], [6, 3], [2, 2], [8, 3, 2, 3], [12, 4], [4, 6]];
const BORDERS = ["solid", "dashed", "dotted"];

const dashNumber = (k) => Math.floor(k / 8) % DASHES.length;
export const dashOf = (k) => DASHES[dashNumber(k)];
export const borderOf = (k) => BORDERS[dashNumber(k) % BORDERS.length];

// Returns a function that gives a colour as drawn: one with too little contrast to the background (yellow on white) is
// darkened or lightened a little.
export function makeColors() {
  const swatch = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true }), known = new Map();
  function lightness(color) {
    if (!known.has(color)) {
      swatch.fillStyle = color;
      swatch.fillRect(0, 0, 1, 1);
      const [red, green, blue] = swatch.getImageData(0, 0, 1, 1).data;
      known.set(color, (0.2126 * red + 0.7152 * green + 0.0722 * blue) / 255);
    }
    return known.get(color);
  }
  return (given, theme) => {
    const color = given === "ink" ? theme.ink : given;
    const seen = Math.abs(lightness(color) - lightness(theme.paper)) > 0.2;
    return seen ? color : `color-mix(in srgb, ${color} 70%, ${theme.ink})`;
  };
}
