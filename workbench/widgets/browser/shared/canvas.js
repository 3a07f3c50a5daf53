export function element(parent, tag, name) {
  const made = document.createElement(tag);
  made.className = name;
  parent.append(made);
  return made;
}

// A plot in `root` that takes mouse and keys: a canvas, another one over it for what moves often, and a box of words.
export function makeStage(root, name) {
  const stage = element(root, "div", "fw-stage"), drawn = element(stage, "canvas", name);
  const over = element(stage, "canvas", "fw-cursor"), hoverBox = element(stage, "div", "fw-hover");
  hoverBox.hidden = true;
  stage.tabIndex = 0;
  stage.setAttribute("role", "application");
  root.dataset.lmSuppressShortcuts = "true";
  return { stage, drawn, over, hoverBox };
}

// The drawing context of a canvas in CSS pixels, sharp on screens with more than one pixel per CSS pixel.
export function cleared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  return context;
}
