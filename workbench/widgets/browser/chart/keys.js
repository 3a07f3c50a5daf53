import { borderOf } from "./colors.js";

// The legend: one button per series.
export function paintKeys(keys, { sent, shown, palette }) {
  const there = [...keys.children].map((key) => key.dataset.name);
  if (there.length !== sent.names.length || there.some((name, k) => name !== sent.names[k])) {
    keys.replaceChildren(...sent.names.map(makeKey));
  }
  sent.names.forEach((_, k) => {
    const key = keys.children[k];
    key.setAttribute("aria-pressed", String(shown(k)));
    key.firstChild.style.borderTopColor = palette[k];
    key.firstChild.style.borderTopStyle = borderOf(k);
  });
}

function makeKey(name) {
  const key = document.createElement("button");
  key.className = "fw-key";
  key.dataset.name = name;
  key.title = "click: show or hide; double-click: only this one, or all";
  key.append(document.createElement("i"), name);
  return key;
}

// The hidden series after a click on the legend, and after a double-click, which shows only this one, or all.
export const afterClick = (hidden, name) =>
  hidden.includes(name) ? hidden.filter((other) => other !== name) : [...hidden, name];

export function afterDouble(hidden, name, names) {
  const others = names.filter((other) => other !== name);
  return others.every((other) => hidden.includes(other)) ? [] : others;
}

export const nameOf = (event) => event.target.closest(".fw-key")?.dataset.name;
