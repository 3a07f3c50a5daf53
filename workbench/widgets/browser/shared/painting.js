const AGAIN_MS = 100, TRIES = 20;

// Paints once a frame, however often it is requested: in the next animation frame, or with `soon` already after the
// message that asks, unless this frame has been painted, so that the device draws while the page waits for its frame.
// `paint(all, asked)`: whether to include parts that rarely change, and the time of the first request; it returns whether
// it has painted. If not, it is tried again for two seconds: JupyterLab takes a cell out of the page for a moment, and no
// observer tells when it is back.
export function onDemand(paint, soon = false) {
  let frame = 0, timer = 0, tries = 0, all = true, asked = 0, wanted = false;
  function run() {
    if (!wanted) return;
    wanted = false;
    if (paint(all, asked)) [all, tries] = [false, 0];
    else if (tries++ < TRIES) timer = setTimeout(request, AGAIN_MS);
  }
  function request() {
    clearTimeout(timer);
    wanted = true;
    if (frame) return;
    frame = requestAnimationFrame(() => { frame = 0; run(); });
    if (soon) queueMicrotask(run);
  }
  return {
    ask(everything = false) {
      all ||= everything;
      if (!wanted) [asked, tries] = [performance.now(), 0];
      request();
    },
    stop() {
      wanted = false;
      clearTimeout(timer);
      cancelAnimationFrame(frame);
    },
  };
}
