// Each of these starts listening and returns the function that stops it.

// `watched`: pairs of a model's event and its callback.
export function follow(model, watched) {
  watched.forEach(([name, callback]) => model.on(name, callback));
  return () => watched.forEach(([name, callback]) => model.off(name, callback));
}

export function listen(target, listeners, options) {
  const each = Object.entries(listeners);
  for (const [name, callback] of each) target.addEventListener(name, callback, options);
  return () => each.forEach(([name, callback]) => target.removeEventListener(name, callback, options));
}

export function followSize(target, callback) {
  const sizes = new ResizeObserver(callback);
  sizes.observe(target);
  return () => sizes.disconnect();
}

// JupyterLab sets its theme as attributes of the page's body.
export function followTheme(callback) {
  const themes = new MutationObserver(callback);
  themes.observe(document.body, { attributes: true });
  return () => themes.disconnect();
}
