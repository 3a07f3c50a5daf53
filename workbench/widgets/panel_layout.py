"""The layout of a panel: its style sheet, rows of controls, columns, and borders that can be moved."""

from collections.abc import Callable, Mapping, Sequence

import ipywidgets as widgets

CONTROLS_PX = 276
"""Width of the settings, which leaves their sliders 150 pixels and more."""
OTHERS_PX = 130
"""Height of what a notebook shows around a panel that is as high as the window."""
LOWEST_PX = 540
LEAST_VIEW_PX = 240
"""Width below which a curve says little."""
ARROW = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 20 20'%3E"
    "%3Cpath d='M6 8.2 10 12.2 14 8.2' fill='none' stroke='%23ddd' stroke-width='1.8'/%3E%3C/svg%3E"
)
"""A picture of an arrow for menus on dark ground."""
STYLE = """<style>
.fw-panel { --jp-widgets-inline-height: 24px; --jp-widgets-font-size: 12px; position: relative; outline: none;
  --fw-accent: var(--jp-brand-color1, #1976d2); --fw-soft: var(--jp-layout-color2, #eee);
  --fw-line: var(--jp-border-color2, #ddd); overflow: visible; }
/* the arrow of menus is black in every theme */
[data-jp-theme-light="false"] .fw-panel { --jp-widgets-dropdown-arrow: url("FW_ARROW"); }
.fw-panel .jupyter-button { padding: 0 6px; line-height: 22px; border-radius: 4px; }
.fw-panel .jupyter-button:focus-visible, .fw-panel .noUi-handle:focus-visible, .fw-panel select:focus-visible
  { outline: 2px solid var(--fw-accent); outline-offset: 1px; }
.fw-panel .jupyter-widget-Tab > .jupyter-widget-TabPanel-tabContents, .fw-panel .widget-tab-contents { padding: 4px; }
.fw-panel .lm-TabBar-tab { min-width: 0; flex: 0 1 auto; padding: 0 8px; font-size: 12px; }
.fw-panel .fw-controls .lm-TabBar-tab { flex: 1 1 auto !important; padding: 0 3px !important; }
.fw-panel .widget-html-content, .fw-panel .jupyter-widget-html-content { line-height: 18px; font-size: 12px; }
.fw-panel table { font-size: 12px; }
.fw-panel td, .fw-panel th { padding: 0 6px; text-align: left; }
.fw-panel .fw-best { font-weight: 600; color: var(--fw-accent); }

/* settings: the slider, below it plain words and the number; the start's value is a line on the slider */
.fw-panel .fw-knob { padding: 1px 4px 2px 5px; border-left: 3px solid transparent; }
.fw-panel .fw-knob > * { margin: 0; }
.fw-panel .fw-knob .widget-label { text-align: left; }
.fw-panel .fw-knob.fw-changed { border-left-color: var(--fw-accent); background: var(--fw-soft); }
.fw-panel .fw-knob.fw-level-1 { margin-left: 8px; }
.fw-panel .fw-knob .fw-below { color: var(--jp-ui-font-color2, #666); }
.fw-panel .fw-knob .fw-below > * { margin: 0 2px 0 0; }
.fw-panel .fw-knob .fw-below .widget-html-content { white-space: nowrap; overflow: hidden; text-overflow: ellipsis;
  color: var(--jp-ui-font-color2, #666); }
.fw-panel .fw-knob .fw-below input { text-align: right; font-variant-numeric: tabular-nums; }
.fw-panel .fw-knob .noUi-base::before { content: ""; position: absolute; top: -4px; bottom: -4px; width: 2px;
  margin-left: -1px; background: var(--jp-ui-font-color2, #666); opacity: 0.55; left: var(--fw-at, -99px); }
FW_AT

/* a panel as high as the window: the views get what is left */
.fw-panel.fw-whole { min-height: calc(max(100vh - FW_OTHERSpx, FW_LOWESTpx)); }
.fw-panel.fw-whole > .fw-body { flex: 1 1 0; min-height: 0; }
/* below high pages, such as eight stages or a film strip, the window scrolls: strip and transport are not cut */
.fw-panel.fw-whole:has(.fw-transport) > .fw-body { min-height: 340px; }
.fw-whole .fw-controls { flex: 0 0 FW_CONTROLSpx; min-width: 0; min-height: 0; }
.fw-whole .fw-controls > .jupyter-widget-Tab, .fw-whole .fw-controls > .widget-tab
  { flex: 1 1 0; min-height: 0; margin: 0; }
.fw-whole .fw-controls .widget-tab-contents, .fw-whole .fw-controls .jupyter-widget-TabPanel-tabContents
  { flex: 1 1 0; min-height: 0; overflow: hidden auto; padding: 4px 0; }
.fw-whole .fw-controls > .widget-vbox { flex: 1 1 0; min-height: 0; }
.fw-whole .fw-main { flex: 1 1 0; min-width: 0; min-height: 0; }
.fw-whole .fw-views { flex: 1 1 0; min-height: 190px; }
.fw-whole .fw-photo { position: relative; }
.fw-whole .fw-chosen { position: absolute; z-index: 5; top: 34px; right: 6px; margin: 0; padding: 1px 3px;
  border-radius: 6px; background: var(--jp-layout-color1, #fff); }
.fw-whole .fw-photo { flex: 1 1 0; min-width: 0; overflow: hidden; }
.fw-whole .fw-head { flex: 0 0 39%; min-width: 0; overflow: hidden; }
.fw-whole .fw-grow { flex: 1 1 0; min-height: 0; position: relative; overflow: hidden; }
.fw-whole .fw-head3d.fw-fill { position: relative; flex: 1 1 0; min-height: 0; width: 100%; margin: 0; }
.fw-whole .fw-split { flex: 0 0 7px; margin: 0; cursor: col-resize; touch-action: none; border-radius: 3px;
  background: linear-gradient(var(--fw-line), var(--fw-line)) center / 1px 100% no-repeat; }
.fw-whole .fw-split.fw-split-y { cursor: row-resize; background-size: 100% 1px; }
.fw-whole .fw-split:hover, .fw-whole .fw-split:focus-visible { background-color: var(--fw-soft); outline: none; }
.fw-whole .fw-pages { flex: 0 0 auto; width: auto; }
.fw-whole .fw-pages > .widget-tab-contents,
.fw-whole .fw-pages > .jupyter-widget-TabPanel-tabContents { padding: 4px 8px; }
.fw-whole .fw-pages.fw-folded > .widget-tab-contents,
.fw-whole .fw-pages.fw-folded > .jupyter-widget-TabPanel-tabContents { display: none; }
.fw-whole .fw-pages.fw-folded .lm-TabBar-tab.lm-mod-current::before { display: none; }
/* the first frame, until the picture with its landmarks is drawn */
.fw-whole > .fw-first { position: absolute; top: 64px; bottom: 150px; left: calc(FW_CONTROLSpx + 14px); margin: 0;
  width: calc(0.61 * (100% - FW_CONTROLSpx - 14px)); object-fit: contain; pointer-events: none; }
.fw-whole:has(.fw-decoded) > .fw-first { display: none; }
.fw-whole .fw-faceless > * { visibility: hidden; }
.fw-whole .fw-faceless::before { content: "no face in this frame"; position: absolute; inset: 0; display: flex;
  align-items: center; justify-content: center; color: var(--jp-ui-font-color2, #666); background: var(--fw-soft); }
.fw-whole .fw-old { opacity: 0.45; transition: opacity 0.2s; }

/* narrow, as where the browser zooms to 125 %: rows go on below; at 200 %: first the views, then the settings */
.fw-panel.fw-whole { container: fw-panel / inline-size; }
@container fw-panel (max-width: 900px) {
  .fw-pages .lm-TabBar-tab { flex: 1 1 auto !important; padding: 0 4px !important; }
}
@container fw-panel (max-width: 800px) {
  .fw-photo .widget-hbox, .fw-head .widget-hbox, .fw-transport { flex-wrap: wrap; height: auto; }
  .fw-photo .fw-group { flex: 0 1 auto !important; min-width: 0; }
  .fw-transport { padding-left: 0 !important; }
  .fw-top-bar { flex-wrap: wrap; }
  .fw-top-bar .fw-status { flex: 1 0 100% !important; order: 9; }
}
@container fw-panel (max-width: 600px) {
  .fw-body { flex: none !important; flex-direction: column; }
  .fw-body > .fw-split, .fw-views > .fw-split { display: none; }
  .fw-body > .fw-main { order: -1; flex: none !important; width: 100%; }
  .fw-main > .fw-views { flex: none !important; flex-direction: column; }
  .fw-views > .fw-photo, .fw-views > .fw-head { flex: none !important; width: 100% !important; height: 330px; }
  .fw-body > .fw-controls { flex: none !important; width: 100% !important; height: 330px; }
  .fw-pages .lm-TabBar-content { flex-wrap: wrap; }
}

/* groups of controls with space between them */
.fw-panel .fw-group { margin-right: 12px; }
.fw-panel .fw-top-bar { flex: 0 0 auto; align-items: center; }
.fw-panel .fw-status { flex: 1 1 0; min-width: 0; overflow: hidden; }
.fw-panel .fw-status .widget-html-content { white-space: nowrap; overflow: hidden; text-overflow: ellipsis;
  font-variant-numeric: tabular-nums; }
.fw-panel .fw-status b { font-weight: 600; }
.fw-panel .fw-meaning { flex: 0 0 auto; margin: 0 4px; color: var(--jp-ui-font-color2, #666); }
.fw-panel .fw-transport { flex: 0 0 auto; align-items: center; padding-left: 48px; }
/* what a running fit says is cut before it makes the line higher */
.fw-panel .fw-transport > .fw-said { flex: 1 1 0; min-width: 0; overflow: hidden; }
.fw-panel .fw-said .widget-html-content { white-space: nowrap; overflow: hidden; text-overflow: ellipsis; }
.fw-panel .fw-play { margin: 2px; width: auto; }
.fw-panel .fw-play button:nth-of-type(2) { display: none; }
.fw-panel .fw-export { flex: 0 0 auto; border: 1px solid var(--jp-border-color2, #ddd); border-radius: 6px;
  padding: 6px 10px; margin: 2px 0 6px; background: var(--jp-layout-color1, #fff); }
.fw-panel .fw-export code { user-select: all; background: var(--fw-soft); padding: 1px 4px; border-radius: 3px;
  white-space: pre-wrap; }
.fw-panel .fw-waiting { flex: 0 1 auto; color: var(--jp-ui-font-color2, #666); white-space: nowrap; }
.fw-panel .fw-spin { display: inline-block; width: 10px; height: 10px; border-radius: 50%; margin-right: 4px;
  border: 2px solid var(--fw-accent); border-right-color: transparent; animation: fw-turn 0.9s linear infinite; }
@keyframes fw-turn { to { transform: rotate(360deg); } }

/* told after a while, unless the panel's own programs have come, whose style hides it (panel/view.css) */
.fw-panel .fw-unloaded { max-height: 0; margin: 0; overflow: hidden; animation: fw-late 0s linear 20s forwards; }
@keyframes fw-late { to { max-height: 140px; } }
</style>"""
UNLOADED = """<b>The picture and the head have not appeared.</b> This front end has not loaded the programs of the
package anywidget. In VS Code, let <code>jupyter.widgetScriptSources</code> name a source; in Colab, run
<code>from google.colab import output; output.enable_custom_widget_manager()</code>; then run this cell again. Or see
the same session without them: <code>from workbench.widgets import PlainPanel; PlainPanel(session)</code>."""


def style_sheet() -> widgets.Widget:
    """An invisible widget with the style of everything in a box of class fw-panel."""
    marks = "\n".join(f".fw-panel .fw-at-{k} {{ --fw-at: {k}%; }}" for k in range(101))
    style = STYLE.replace("FW_AT", marks)
    style = style.replace("FW_ARROW", ARROW)
    for name, pixels in (("OTHERS", OTHERS_PX), ("LOWEST", LOWEST_PX), ("CONTROLS", CONTROLS_PX)):
        style = style.replace(f"FW_{name}", str(pixels))
    return widgets.HTML(style, layout=widgets.Layout(display="none"))


def unloaded_note() -> widgets.Widget:
    """What a front end shows that cannot load the views of a panel."""
    return classed(widgets.HTML(UNLOADED), "fw-unloaded")


def in_line(*parts: widgets.Widget) -> widgets.Widget:
    """Controls side by side."""
    return widgets.HBox(parts, layout=widgets.Layout(align_items="center"))


def wrapped() -> widgets.Layout:
    """Layout of a line of controls that goes on below where the place is narrow."""
    return widgets.Layout(flex_flow="row wrap", align_items="center", flex="0 0 auto")


def one_row() -> widgets.Layout:
    """Layout of a line of controls that stays one, and as high as it is."""
    return widgets.Layout(align_items="center", flex="0 0 auto", width="auto")


class Beside(widgets.HBox):
    """Rows of controls, and a view that takes what is left of the width, or all of it below them if that is little."""

    def __init__(self, rows: Sequence[widgets.Widget], width_px: int, view: widgets.Widget, height_px: int) -> None:
        """`width_px` is that of the controls, which scroll where they are higher than `height_px`."""
        controls = widgets.Layout(
            flex=f"0 1 {width_px}px", max_height=f"{height_px}px", margin="0 12px 0 0", overflow="hidden auto"
        )
        left = widgets.Layout(flex=f"1 1 {LEAST_VIEW_PX}px", min_width="0")
        super().__init__(
            [widgets.VBox(rows, layout=controls), widgets.VBox([view], layout=left)],
            layout=widgets.Layout(flex_flow="row wrap", min_height=f"{height_px}px"),
        )


def group(*parts: widgets.Widget, name: str = "") -> widgets.Widget:
    """Controls that belong together, with space after them; `name` is a class besides."""
    made = in_line(*parts)
    made.layout.flex = "0 0 auto"
    made.add_class("fw-group")
    if name:
        made.add_class(name)
    return made


def classed(widget: widgets.Widget, *names: str) -> widgets.Widget:
    """The widget, with these classes."""
    for name in names:
        widget.add_class(name)
    return widget


def border(across: bool = False) -> widgets.Widget:
    """A border that can be moved and resizes what stands before it; `across`: its height, not its width."""
    return classed(widgets.HTML(), "fw-split", *(["fw-split-y"] if across else []))


def tabs(pages: Mapping[str, widgets.Widget | None]) -> widgets.Tab:
    """Pages by title, without those that are None, for the foot of a panel: tables need its whole width."""
    there = {title: page for title, page in pages.items() if page is not None}
    return classed(widgets.Tab(children=list(there.values()), titles=list(there)), "fw-pages")


def on_turn(pages: widgets.Tab, callbacks: Mapping[str, Callable[[bool], None]]) -> None:
    """Each time another page comes to the front, tell pages by their titles whether they are the one."""

    def turned(change) -> None:
        front = None if change["new"] is None else pages.titles[change["new"]]
        for title, callback in callbacks.items():
            callback(title == front)

    pages.observe(turned, "selected_index")


def arranged(
    settings: widgets.Widget, photo: widgets.Widget, head: widgets.Widget, clip: Sequence[widgets.Widget]
) -> widgets.Widget:
    """Settings beside the views, below which are the rows of the clip; borders between them move."""
    views = classed(widgets.HBox([classed(photo, "fw-photo"), border(), classed(head, "fw-head")]), "fw-views")
    main = classed(widgets.VBox([views, border(across=True), *clip]), "fw-main")
    return classed(widgets.HBox([settings, border(), main]), "fw-body")


def in_columns(*parts: widgets.Widget) -> widgets.Widget:
    """Controls, and a picture that takes the remaining width."""
    layout = widgets.Layout(grid_template_columns=f"{CONTROLS_PX}px minmax(240px, 1fr)", grid_gap="6px", width="100%")
    return widgets.GridBox(parts, layout=layout)
