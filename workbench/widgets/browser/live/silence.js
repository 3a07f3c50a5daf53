const SLOW_MS = 3000, SILENT_MS = 60000; // without an answer from the kernel
const LOST_MS = 5000; // after which a frame, or its answer, may have got lost on the way

// Time since the first frame that the kernel has not answered; pauses before that frame do not count.
export function makeSilence() {
  let owed = null, sent = null;
  const since = (now) => (owed === null ? 0 : now - owed);
  return {
    onFrame: (now) => void ((owed ??= now), (sent = now)),
    onAnswer: () => void (owed = null),
    isSlow: (now) => since(now) > SLOW_MS,
    isOver: (now) => since(now) > SILENT_MS,
    isLost: (now) => owed !== null && now - sent > LOST_MS,
  };
}
