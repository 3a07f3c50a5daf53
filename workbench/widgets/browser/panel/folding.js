import { listen } from "../shared/following.js";

const LOW = 900; // windows lower than this begin with the pages folded, so that the face gets their height
const PAGES = ".fw-pages", TABS = ":scope > .lm-TabBar .lm-TabBar-tab, :scope > .p-TabBar .p-TabBar-tab";

// A click on the tab in front folds the pages away, a click on any tab unfolds them.
export function foldPages(page) {
  let ready = false;

  function begin() {
    const pages = page.panel()?.querySelector(PAGES);
    if (ready || !pages) return;
    ready = true;
    pages.classList.toggle("fw-folded", window.innerHeight < LOW);
  }

  function onDown(event) {
    if (!page.holds(event.target) || event.button !== 0) return;
    const pages = event.target.closest(PAGES), tab = event.target.closest(".lm-TabBar-tab, .p-TabBar-tab");
    if (!pages || !tab || ![...pages.querySelectorAll(TABS)].includes(tab)) return;
    const front = tab.classList.contains("lm-mod-current") || tab.classList.contains("p-mod-current");
    const folded = front && !pages.classList.contains("fw-folded");
    setTimeout(() => pages.classList.toggle("fw-folded", folded)); // the tab bar looks first where it was clicked
  }

  const frame = setInterval(() => { begin(); if (ready) clearInterval(frame); }, 50);
  const stop = listen(document, { pointerdown: onDown }, true);
  return () => { clearInterval(frame); stop(); };
}
