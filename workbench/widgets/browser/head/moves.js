const ANSWER_MS = 600; // the next movement is sent after this time even without an answer
const NOTHING = { turn: [0, 0], pan: [0, 0], zoom: 1, reset: false };

// Combines two movements.
export function joined(waiting, change) {
  const add = (a, b) => (b ? [a[0] + b[0], a[1] + b[1]] : a);
  if (change.reset) return { ...NOTHING, reset: true };
  return {
    turn: add(waiting.turn, change.turn), pan: add(waiting.pan, change.pan),
    zoom: waiting.zoom * (change.zoom || 1), reset: waiting.reset,
  };
}

// Sends movements, one at a time: the next one waits for the picture and combines everything that happened until then.
export function makeMoves(model) {
  let waiting = NOTHING, pending = false, timer = null;
  let sent = Date.now(); // increases across page reloads, and differs between two displays
  function send() {
    if (!pending || timer !== null) return;
    sent += 1;
    model.send({ kind: "move", number: sent, ...waiting });
    [waiting, pending] = [NOTHING, false];
    timer = setTimeout(answered, ANSWER_MS);
  }
  function answered() {
    clearTimeout(timer);
    timer = null;
    send();
  }
  return {
    move(change) {
      [waiting, pending] = [joined(waiting, change), true];
      send();
    },
    onDone() {
      if (model.get("_done") >= sent) answered();
    },
    stop: () => clearTimeout(timer),
  };
}
