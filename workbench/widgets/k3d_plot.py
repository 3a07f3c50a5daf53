"""A k3d plot that brings its program along, so that it draws while the kernel is busy."""

import gzip
from functools import lru_cache
from pathlib import Path

import anywidget
import ipywidgets as widgets
import k3d
import traitlets

PROGRAM = Path(k3d.__file__).parent / "static" / "widget.mjs"
HOLD_PROGRAM = "export default { render() {} };"
LOAD_PROGRAM = """
const KEY = "__k3dWidgetModule"; // where k3d itself keeps its program: once on a page, whoever brings it

async function unpacked(model) {
  const id = model.get("_program").slice("IPY_MODEL_".length);
  const packed = (await model.widget_manager.get_model(id)).get("_packed");
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const text = await new Response(stream).text();
  const address = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  try {
    return (await import(address)).default;
  } finally {
    URL.revokeObjectURL(address);
  }
}

function load(model) {
  globalThis[KEY] ??= unpacked(model).catch((error) => {
    delete globalThis[KEY];
    throw error;
  });
  return globalThis[KEY];
}

function later(hook) {
  return (context) => {
    let cleanup = null, cancelled = false;
    load(context.model).then(
      (program) => { if (!cancelled) cleanup = program[hook](context); },
      (error) => console.error("the 3D view's program could not be loaded", error),
    );
    return () => {
      cancelled = true;
      if (typeof cleanup === "function") cleanup();
    };
  };
}

export default { initialize: later("initialize"), render: later("render") };
"""


class K3dProgram(anywidget.AnyWidget):
    """k3d's JavaScript, compressed; all plots of a kernel share one."""

    _esm = HOLD_PROGRAM
    _packed = traitlets.Bytes().tag(sync=True)


class ReadyPlot(k3d.Plot):
    """A `k3d.Plot` that needs no answer of the kernel to be drawn.

    k3d's own lets the browser ask the kernel for the program, and a kernel that runs a cell answers when that ends:
    through all of "Run all" the plot stayed empty.
    """

    _esm = LOAD_PROGRAM
    _program = traitlets.Instance(K3dProgram).tag(sync=True, **widgets.widget_serialization)

    def __init__(self, **options: object) -> None:
        super().__init__(_program=shared_program(), **options)


def shared_program() -> K3dProgram:
    """The program of this kernel's plots; made anew where it was closed with all other widgets."""
    program = _made_program()
    if program.comm is None:
        _made_program.cache_clear()
        program = _made_program()
    return program


@lru_cache(maxsize=1)
def _made_program() -> K3dProgram:
    return K3dProgram(_packed=gzip.compress(PROGRAM.read_bytes(), mtime=0))
