const POINTS = 68, EYE_PER_SPREAD = 1.48, LEAST_UNIT = 0.5;

// As `landmarks/scheme.py`: the distance of the outer eye corners, on a profile a part of the spread of the 68 points.
// `place` gives the position of a point by its number.
export function errorUnit(place) {
  const places = Array.from({ length: POINTS }, (_, i) => place(i));
  const mean = (of) => places.reduce((sum, p) => sum + of(p), 0) / POINTS;
  const x = mean((p) => p[0]), y = mean((p) => p[1]);
  const spread = Math.sqrt(mean((p) => (p[0] - x) ** 2 + (p[1] - y) ** 2));
  const corners = Math.hypot(places[36][0] - places[45][0], places[36][1] - places[45][1]);
  return Math.max(corners, LEAST_UNIT * EYE_PER_SPREAD * spread);
}
