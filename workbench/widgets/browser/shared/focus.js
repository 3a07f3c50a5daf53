// Keeps an element's keys from JupyterLab, which looks for shortcuts at the element with the focus before any other.
export function keepKeys(focused) {
  focused.dataset.lmSuppressShortcuts = "true";
}

// Lets an element have the focus, and its own keys.
export function takeFocus(element) {
  element.tabIndex = 0;
  keepKeys(element);
}
