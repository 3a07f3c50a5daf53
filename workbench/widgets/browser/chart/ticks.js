// Round numbers in [low, high], about `most` of them.
export function linearTicks(low, high, most) {
  const rough = (high - low) / Math.max(most, 1), decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * decade).find((k) => k >= rough * 0.999);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-6); k * step <= high + step * 1e-6; k++) ticks.push(k * step);
  return ticks;
}

// Powers of ten between two exponents; if there are too few, also twice and five times these.
export function logTicks(low, high, most) {
  const step = Math.max(1, Math.ceil((high - low) / most)), ticks = [];
  const factors = high - low < 2 ? [1, 2, 5] : [1];
  for (let power = Math.floor(low); power <= high; power++) {
    if (((power % step) + step) % step) continue;
    for (const factor of factors) {
      const place = power + Math.log10(factor);
      if (place >= low - 1e-9 && place <= high + 1e-9) ticks.push(place);
    }
  }
  return ticks;
}

export function words(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const short = size === 0 || (size < 1e5 && size >= 1e-3);
  const text = short ? String(+value.toPrecision(4)) : value.toExponential(1).replace(".0e", "e").replace("e+", "e");
  return text.replaceAll("-", "−");
}
