import { listen } from "../shared/following.js";
import { actionOf } from "./help.js";

const TYPED = "input:not([type=checkbox]), textarea, [contenteditable=true]", PRESSED = "button, select, input";

const focusSearch = (page) => page.panel().querySelector(".fw-controls input")?.focus();
const tellOverlay = (page, key) =>
  page.panel().querySelector(".fw-overlay")?.dispatchEvent(new CustomEvent("fw-key", { detail: key }));
const HERE = { search: focusSearch, overlay: tellOverlay, help: (page) => page.help.toggle() };

// Keys while the focus is in the panel, but not in a field; views handle their own first.
export function listenToKeys(page) {
  function wanted(event) {
    if (event.altKey || event.defaultPrevented || !page.holds(event.target) || event.target.closest(TYPED)) return;
    if (event.ctrlKey || event.metaKey) {
      const letter = event.key.toLowerCase();
      return { z: event.shiftKey ? "redo" : "undo", y: "redo" }[letter];
    }
    if (event.key === " " && event.target.closest(PRESSED)) return undefined;
    return event.key === "Escape" ? "overlay" : actionOf(event.key);
  }

  function onKey(event) {
    const action = wanted(event);
    if (!action) return;
    event.preventDefault();
    event.stopPropagation();
    if (action === "why") page.panel().querySelector(".fw-pages")?.classList.remove("fw-folded");
    if (HERE[action]) HERE[action](page, event.key);
    else page.tell("key", action);
  }

  // An Esc that closes the help does nothing else; it is heard before the views, which have one of their own.
  function onFirst(event) {
    if (event.key !== "Escape" || !page.help.close() || !page.holds(event.target)) return;
    event.preventDefault();
    event.stopPropagation();
  }

  // A click on nothing in particular brings the focus into the panel, so that its keys work.
  function onClick(event) {
    if (page.holds(event.target) && !page.panel().contains(document.activeElement)) {
      page.panel().focus({ preventScroll: true });
    }
  }
  const onHelp = (event) => page.holds(event.target) && event.target.closest(".fw-help-button") && page.help.toggle();
  const stops = [
    listen(document, { keydown: onFirst }, { capture: true }),
    listen(document, { keydown: onKey, click: (event) => { onHelp(event); onClick(event); } }),
  ];
  return () => stops.forEach((stop) => stop());
}
