const AHEAD = 2; // most frames without an answer from the kernel: one in transit while another is fitted
const JPEG_QUALITY = 0.85;
const WHY = {
  NotAllowedError: "denied", SecurityError: "denied", NotFoundError: "absent", OverconstrainedError: "absent",
  NotReadableError: "busy", AbortError: "busy",
};

// Opens the browser's camera and delivers its latest frame whenever the kernel has few enough unanswered ones.
export function makeCamera(onFrame, onTrouble) {
  let stream = null, video = null, opening = false, turn = 0, fresh = false, number = 0, answered = -1;
  let takeAgain = () => {};

  // Asked for a camera that is open, whoever asks has forgotten the frames that wait for an answer.
  async function open([width, height]) {
    if (stream) return forget();
    if (opening) return;
    const mine = ++turn;
    if (!navigator.mediaDevices?.getUserMedia) return onTrouble("insecure");
    opening = true;
    try {
      const opened = await streamOf(width, height);
      if (mine !== turn) return opened.getTracks().forEach((track) => track.stop()); // stopped in the meantime
      stream = opened;
      stream.getVideoTracks()[0].addEventListener("ended", () => {
        if (mine === turn) close(), onTrouble("ended");
      });
      video = document.createElement("video");
      Object.assign(video, { muted: true, playsInline: true, srcObject: stream });
      await video.play();
    } catch (error) {
      if (mine !== turn) return;
      close();
      return onTrouble(WHY[error.name] || "failed", error.name);
    }
    if (mine !== turn) return;
    opening = false;
    watch(mine, width, height);
  }

  function watch(mine, width, height) {
    answered = number - 1;
    const scale = () => Math.min(1, width / video.videoWidth, height / video.videoHeight);
    const next = () => {
      if (mine !== turn) return;
      fresh = true;
      take(scale);
      video.requestVideoFrameCallback(next);
    };
    takeAgain = () => take(scale);
    video.requestVideoFrameCallback(next);
  }

  // If the kernel is slower than the camera, frames are skipped here and never queue up.
  function take(scale) {
    if (number - 1 - answered >= AHEAD || !fresh || !video.videoWidth) return;
    fresh = false;
    const grabbed = performance.now(), picture = grab(video, scale());
    onFrame({ number: number++, grabbed, picture }, jpegOf(picture));
  }

  function close() {
    turn++;
    stream?.getTracks().forEach((track) => track.stop());
    if (video) video.srcObject = null;
    stream = video = null;
    opening = false;
  }

  // The kernel has answered this frame; earlier ones were skipped.
  function release(done) {
    answered = Math.max(answered, done);
    if (stream) takeAgain();
  }

  const forget = () => release(number - 1);
  const ended = () => stream?.getVideoTracks()[0].dispatchEvent(new Event("ended"));
  const isOpen = () => Boolean(stream), isClosed = () => !stream && !opening;
  return { open, close, release, forget, isOpen, isClosed, unplug: ended };
}

function streamOf(width, height) {
  const video = { width: { ideal: width }, height: { ideal: height }, frameRate: { ideal: 30 } };
  return navigator.mediaDevices.getUserMedia({ audio: false, video });
}

function grab(video, scale) {
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(video.videoWidth * scale);
  canvas.height = Math.round(video.videoHeight * scale);
  const context = canvas.getContext("2d", { alpha: false, willReadFrequently: true });
  context.drawImage(video, 0, 0, canvas.width, canvas.height);
  return canvas;
}

// Synchronous, because browsers encode blobs when idle, which took 30 ms here instead of 4.
function jpegOf(canvas) {
  const text = atob(canvas.toDataURL("image/jpeg", JPEG_QUALITY).split(",")[1]);
  return Uint8Array.from(text, (letter) => letter.charCodeAt(0)).buffer;
}
