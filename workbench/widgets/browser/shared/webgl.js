// The result of `look` on a WebGL context, undefined without one. Browsers allow about 16 contexts per page, so this
// one is released at once.
function lookAtWebGL(look) {
  const context = document.createElement("canvas").getContext("webgl2");
  const found = context ? look(context) : undefined;
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return found;
}

export const hasWebGL = () => Boolean(lookAtWebGL(() => true));

// Without a graphics card.
export function drawsInSoftware() {
  const name = lookAtWebGL((context) => {
    const told = context.getExtension("WEBGL_debug_renderer_info");
    return told ? context.getParameter(told.UNMASKED_RENDERER_WEBGL) : "";
  });
  return /swiftshader|llvmpipe|software/i.test(name ?? "");
}
