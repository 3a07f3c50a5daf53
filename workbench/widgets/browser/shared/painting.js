// Paints once in the next animation frame, however often it is requested. `paint(all, asked)`: whether to include parts
// that rarely change, and the time of the first request; it returns whether it has painted.
export function onDemand(paint) {
  let frame = 0, all = true, asked = 0;
  function run() {
    frame = 0;
    if (paint(all, asked)) all = false;
  }
  return {
    ask(everything = false) {
      all ||= everything;
      if (frame) return;
      asked = performance.now();
      frame = requestAnimationFrame(run);
    },
    stop: () => cancelAnimationFrame(frame),
  };
}
