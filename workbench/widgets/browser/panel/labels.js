const SOON_MS = 400;
const CONTROLS = "button, input, select, textarea, .noUi-handle";
const ICONS = { "fa-play": "play", "fa-pause": "pause", "fa-stop": "stop", "fa-retweet": "loop" };

// Names for screen readers: controls that show a symbol or nothing are called what their tooltip says. `changed`: parts of
// the panel; all of it takes as long as to draw a head.
export function labelControls(panel, changed = [panel]) {
  const within = (part) => [...(part.matches(CONTROLS) ? [part] : []), ...part.querySelectorAll(CONTROLS)];
  for (const control of new Set(changed.flatMap(within))) {
    if (control.labels?.length || (control.ariaLabel && control.ariaLabel !== control.dataset.told)) continue;
    const icon = control.querySelector("i.fa"), shown = icon && Object.keys(ICONS).find((name) => icon.matches(`.${name}`));
    const told = ICONS[shown] || control.closest("[title]")?.title.split("\n")[0] || control.placeholder;
    const named = control.matches("button") && /\p{L}{2}/u.test(control.textContent);
    if (told && !named) control.ariaLabel = control.dataset.told = told;
  }
  for (const border of panel.querySelectorAll(".fw-split")) {
    border.tabIndex = 0;
    border.setAttribute("role", "separator");
    border.setAttribute("aria-label", "border: drag or arrow keys move it, a double click puts it back");
  }
  if (!panel.hasAttribute("tabindex")) panel.tabIndex = -1;
}

// Labels a panel shortly after it was shown or changed.
export function labelSoon(page) {
  let timer = 0, watch = null, changed = null; // null: all of the panel
  const ask = () => { timer ||= setTimeout(label, SOON_MS); };
  function label() {
    timer = 0;
    const panel = page.panel();
    if (!panel) return ask();
    labelControls(panel, changed ? [...changed] : [panel]);
    changed = new Set();
    if (watch) return;
    watch = new MutationObserver((changes) => {
      for (const { target } of changes) changed?.add(target);
      ask();
    });
    watch.observe(panel, { subtree: true, attributeFilter: ["title"] });
  }
  function soon() {
    changed = null;
    ask();
  }
  return { soon, stop: () => { clearTimeout(timer); watch?.disconnect(); } };
}
