// What a panel does in the page itself: drags of sliders, resets, movable borders, folded pages, keys and labels.
import { keepKeys } from "../shared/focus.js";
import { listen } from "../shared/following.js";
import { keepHearing } from "../shared/hearing.js";
import { listenToCopies } from "./copying.js";
import { takeDownloads } from "./downloads.js";
import { watchDrags } from "./drags.js";
import { foldPages } from "./folding.js";
import { makeHelp } from "./help.js";
import { listenToKeys } from "./keys.js";
import { labelSoon } from "./labels.js";
import { listenToResets } from "./resets.js";
import { moveBorders } from "./splitting.js";

function render({ model, el }) {
  el.classList.add("fw-page");
  // The element gets its place in the page after it is rendered.
  const page = { panel: () => el.closest(".fw-panel"), tell: (kind, what) => model.send({ kind, what }) };
  page.holds = (node) => node instanceof Element && Boolean(page.panel()?.contains(node));
  page.help = makeHelp(el);
  const labels = labelSoon(page);
  const stops = [
    watchDrags(model), listenToResets(page), moveBorders(page), foldPages(page), listenToCopies(page),
    takeDownloads(model),
    model.get("has_keys") ? listenToKeys(page) : () => {}, labels.stop,
    listen(document, { click: (event) => page.holds(event.target) && labels.soon() }, true),
    listen(document, { focusin: (event) => page.holds(event.target) && keepKeys(event.target) }),
  ];
  labels.soon();
  return () => stops.forEach((stop) => stop());
}

export default { initialize: keepHearing, render };
