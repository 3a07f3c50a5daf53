// What has changed in another widget came with a message of this one: both are drawn before the page's next frame.
export function handOn(model) {
  model.on("change:_carried", async () => {
    const { to, state } = model.get("_carried");
    if (!to) return;
    const other = await Promise.resolve(model.widget_manager.get_model(to)).catch(() => null);
    other?.set_state(state); // none where it has been closed, or not made yet: it comes with all its state
  });
}
