const AGAIN_MS = 100, TRIES = 20;

// Paints once in the next animation frame, however often it is requested. `paint(all, asked)`: whether to include parts
// that rarely change, and the time of the first request; it returns whether it has painted. If not, it is tried again
// for two seconds: JupyterLab takes a cell out of the page for a moment, and no observer tells when it is back.
export function onDemand(paint) {
  let frame = 0, timer = 0, tries = 0, all = true, asked = 0;
  function run() {
    frame = 0;
    if (paint(all, asked)) [all, tries] = [false, 0];
    else if (tries++ < TRIES) timer = setTimeout(request, AGAIN_MS);
  }
  function request() {
    clearTimeout(timer);
    frame ||= requestAnimationFrame(run);
  }
  return {
    ask(everything = false) {
      all ||= everything;
      if (!frame) [asked, tries] = [performance.now(), 0];
      request();
    },
    stop() {
      clearTimeout(timer);
      cancelAnimationFrame(frame);
    },
  };
}
