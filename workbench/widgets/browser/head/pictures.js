// Shows the latest picture of the head and sends the actions of mouse, fingers and keyboard.
import { bytesOf } from "../shared/bytes.js";
import { follow } from "../shared/following.js";
import { keepHearing } from "../shared/hearing.js";
import { listenTo } from "./mouse.js";
import { makeMoves } from "./moves.js";
import { makePage } from "./page.js";

// Draws pictures as they arrive, and skips one that is decoded after a newer one has arrived.
function makeDrawing(model, canvas) {
  const context = canvas.getContext("2d");
  let newest = 0;
  async function draw() {
    const view = model.get("_jpeg"), number = ++newest;
    if (!view || !view.byteLength) return;
    const picture = await createImageBitmap(new Blob([bytesOf(view)], { type: "image/jpeg" }));
    if (number === newest) context.drawImage(picture, 0, 0, canvas.width, canvas.height);
    picture.close();
  }
  return { draw, stop: () => (newest += 1) };
}

function render({ model, el }) {
  const [width, height] = model.get("_size"), { canvas, message } = makePage(el, "fw-pictures", width, height);
  const { draw, stop } = makeDrawing(model, canvas), moves = makeMoves(model);
  const onMessage = () => { message.textContent = model.get("_message"); };
  const stops = [
    listenTo(canvas, () => width / canvas.getBoundingClientRect().width, moves.move), moves.stop, stop,
    follow(model, [["change:_jpeg", draw], ["change:_done", moves.onDone], ["change:_message", onMessage]]),
  ];
  draw();
  onMessage();
  return () => stops.forEach((end) => end());
}

export default { initialize: keepHearing, render };
