// Paints in the next animation frame, however often it is asked. `paint(all, asked)`: whether also what changes rarely,
// and when it was asked first; it returns whether it has painted.
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
