const GONE_MS = 1500; // a display that is moved within a notebook vanishes for a moment: then the camera closes
const LEFT_MS = 8000; // and then nobody is expected to come back

// What follows when the last display has gone, unless one comes back meanwhile.
export function makeLeaving(onGone, onLeft) {
  let timer = 0;
  const stop = () => (clearTimeout(timer), (timer = 0));
  const start = () => {
    stop();
    timer = setTimeout(() => {
      onGone();
      timer = setTimeout(() => (stop(), onLeft()), LEFT_MS - GONE_MS);
    }, GONE_MS);
  };
  return { start, stop, isUnderWay: () => timer !== 0 };
}
