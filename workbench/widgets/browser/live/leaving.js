const GONE_MS = 1500; // after this the camera closes; a display moved within a notebook disappears for less
const LEFT_MS = 8000; // after this no display is expected to return

// Actions after the last display has gone, unless one returns in time.
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
