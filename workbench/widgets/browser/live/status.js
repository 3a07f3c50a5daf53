const WINDOW_MS = 2000; // window for counting rates
const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

// Number of log entries drawn in the last seconds, rate per second, and delay in ms.
export function recentOf(log, now) {
  const recent = log.filter((entry) => now - entry.drawn < WINDOW_MS);
  const delay = recent.length ? median(recent.map((entry) => entry.drawn - entry.grabbed)) : NaN;
  return { count: recent.length, rate: recent.length / (WINDOW_MS / 1000), delay };
}

// The status line below the pictures.
export function statusOf(fit, { rate, delay }) {
  const [yaw, pitch, roll] = fit.angles || [];
  const sign = (value) => (value < 0 ? "−" : "+") + Math.abs(value).toFixed(0) + "°";
  const parts = [`${rate.toFixed(0)} updates/s`];
  if (!fit.fromKernel) parts.push(`${delay.toFixed(0)} ms camera to screen`);
  parts.push(`landmarks + fit ${fit.ms.toFixed(0)} ms`);
  if (fit.found) parts.push(`error ${fit.error.toFixed(1)} px`, `yaw ${sign(yaw)} pitch ${sign(pitch)} roll ${sign(roll)}`);
  return parts.join("  ·  ");
}
