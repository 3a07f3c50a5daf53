// JupyterLab's colours and font at an element, with defaults for pages without them.
export function themeOf(root) {
  const style = getComputedStyle(root);
  const read = (name, otherwise) => style.getPropertyValue(name).trim() || otherwise;
  return {
    ink: read("--jp-ui-font-color1", "#222"), muted: read("--jp-ui-font-color2", "#777"),
    paper: read("--jp-layout-color0", "#fff"), ground: read("--jp-layout-color2", "#eee"),
    grid: read("--jp-border-color2", "#ddd"), font: style.fontFamily,
  };
}
