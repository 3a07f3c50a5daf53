// anywidget gives a program two seconds to load. A model whose program loads later, as in a page that is busy with the
// hundreds of controls of a panel, is shown but hears nothing from the kernel: each message waits for a promise that was
// rejected. Such a model is found here and hears past that promise; it asks for its state, which it has missed.
const NO_NEWS = { content: { data: { method: "none" } } };

// For a program's `initialize`, which must not wait: until it returns, every model seems not to hear. `missed` asks for
// what is no part of the state.
export function keepHearing({ model }, missed = () => {}) {
  const real = modelBehind(model), hear = real && Object.getPrototypeOf(real.constructor.prototype)._handle_comm_msg;
  if (!hear || !real.comm) return;
  Promise.resolve(real._handle_comm_msg(NO_NEWS)).catch(() => {
    real.comm.on_msg(async (message) => {
      await hear.call(real, message);
      await dressViews(real);
    });
    real.comm.send({ method: "request_state" }, {}, {}, []);
    missed();
  });
}

// anywidget ends what a view follows by itself, so that a class which came after the view was made would not show.
async function dressViews(real) {
  for (const view of Object.values(real.views ?? {})) (await view).el.classList.add(...real.get("_dom_classes"));
}

// Programs get a few functions of a model; events carry the model itself.
function modelBehind(model) {
  let found = null;
  const look = (real) => { found = real; };
  model.on("change:_hears", look);
  model.set("_hears", true);
  model.off("change:_hears", look);
  return found;
}
