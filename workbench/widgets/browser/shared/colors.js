// CSS colours of a table of RGB bytes, from residual 0 to the end of the scale.
export const cssColors = (table) =>
  Array.from({ length: table.length / 3 }, (_, k) => `rgb(${table.slice(3 * k, 3 * k + 3).join()})`);

export const gradientOf = (colors) => `linear-gradient(90deg, ${colors.filter((_, k) => k % 17 === 0).join(", ")})`;
