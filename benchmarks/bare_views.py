"""The least that a slider in a notebook can redraw through the kernel: a photo with 68 dots, and a head in WebGL.

Both are drawn as their message comes, not in the next animation frame: that costs a tenth of the time.
"""

import anywidget
import ipywidgets as widgets
import numpy as np
import traitlets

from workbench.face import FaceModel
from workbench.widgets.encoded_pictures import picture_bytes

CANVAS = """export default { render({ model, el }) {
  const [width, height] = model.get("size"), canvas = document.createElement("canvas");
  Object.assign(canvas, { width, height, className: "bare-canvas" });
  el.append(canvas);
  const context = canvas.getContext("2d");
  let image = null;
  function draw() {
    const { buffer, byteOffset, byteLength } = model.get("points");
    const points = new Float32Array(buffer.slice(byteOffset, byteOffset + byteLength));
    if (image) context.drawImage(image, 0, 0, width, height);
    for (let k = 0; k < points.length; k += 2) {
      context.beginPath();
      context.arc(points[k] * width, points[k + 1] * height, 3, 0, 7);
      context.fill();
    }
  }
  createImageBitmap(new Blob([model.get("picture")])).then((decoded) => { image = decoded; draw(); });
  model.on("change:points", draw);
} };"""
HEAD = """const VERTEX = `#version 300 es
in vec3 place; uniform vec4 fit; out vec3 at;
void main() { at = place; gl_Position = vec4(fit.xy * place.xy, fit.z * place.z, 1.0) + vec4(0, fit.w, 0, 0); }`;
const FRAGMENT = `#version 300 es
precision highp float; in vec3 at; out vec4 color;
void main() { color = vec4(vec3(abs(normalize(cross(dFdx(at), dFdy(at))).z)), 1.0); }`;
const viewed = (kind, view) => new kind(view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength));
export default { render({ model, el }) {
  const [width, height] = model.get("size"), canvas = document.createElement("canvas");
  Object.assign(canvas, { width, height, className: "bare-head" });
  el.append(canvas);
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false }), program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, "place");
  gl.linkProgram(program);
  gl.useProgram(program);
  const triangles = viewed(Uint32Array, model.get("triangles"));
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
  gl.enable(gl.DEPTH_TEST);
  const scale = model.get("scale");
  gl.uniform4f(gl.getUniformLocation(program, "fit"), scale * height / width, -scale, 0.2 * scale, 0);
  function draw() {
    gl.bufferData(gl.ARRAY_BUFFER, viewed(Float32Array, model.get("vertices")), gl.DYNAMIC_DRAW);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_INT, 0);
    gl.deleteSync(gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0));
    gl.flush();
  }
  model.on("change:vertices", draw);
  draw();
} };"""


class BareCanvas(anywidget.AnyWidget):
    """A picture and dots on it."""

    _esm = CANVAS
    size = traitlets.List().tag(sync=True)
    picture = traitlets.Bytes().tag(sync=True)
    points = traitlets.Bytes().tag(sync=True)


class BareHead(anywidget.AnyWidget):
    """Triangles whose vertices come from the kernel."""

    _esm = HEAD
    size = traitlets.List().tag(sync=True)
    scale = traitlets.Float().tag(sync=True)
    triangles = traitlets.Bytes().tag(sync=True)
    vertices = traitlets.Bytes().tag(sync=True)


def bare_panel(
    model: FaceModel, photo: np.ndarray, points: np.ndarray, sizes: tuple[tuple[int, int], tuple[int, int]]
) -> widgets.VBox:
    """A slider that moves 68 dots over a photo and opens the head's first shape; `sizes` in pixels, picture and head.

    The kernel computes one product for each, and sends what the panel sends: points, and the head's vertices.
    """
    height, width = photo.shape[:2]
    places = points / (width, height)
    centred = model.neutral - model.neutral.mean(axis=0)
    shape = model.expression_deltas[0]
    slider = widgets.FloatSlider(0.5, min=0.0, max=1.0, step=0.01, description="bare", readout=False)

    def at(value: float) -> tuple[bytes, bytes]:
        return tuple(made.astype("<f4").tobytes() for made in (places + 0.05 * value, centred + value * shape))

    first = at(slider.value)
    canvas = BareCanvas(size=list(sizes[0]), picture=picture_bytes(photo), points=first[0])
    head = BareHead(
        size=list(sizes[1]), scale=1.6 / float(np.ptp(centred[:, 1])),
        triangles=model.triangles.astype("<u4").tobytes(), vertices=first[1],
    )  # fmt: skip

    def moved(change: dict) -> None:
        canvas.points, head.vertices = at(change["new"])

    slider.observe(moved, "value")
    return widgets.VBox([slider, widgets.HBox([canvas, head])])
