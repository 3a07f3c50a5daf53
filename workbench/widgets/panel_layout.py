"""The layout of a panel: its style sheet, rows of controls, columns."""

import ipywidgets as widgets

CONTROLS_PX = 262
STYLE = """<style>
.fw-panel { --jp-widgets-inline-height: 24px; --jp-widgets-font-size: 12px; max-width: 1500px; }
.fw-panel .jupyter-button { padding: 0 5px; line-height: 22px; }
.fw-panel .jupyter-widget-Tab > .jupyter-widget-TabPanel-tabContents, .fw-panel .widget-tab-contents { padding: 4px; }
.fw-panel .lm-TabBar-tab { min-width: 0; flex: 0 1 auto; padding: 0 6px; font-size: 12px; }
.fw-panel .fw-controls .lm-TabBar-tab { flex: 1 1 auto !important; padding: 0 3px !important; }
.fw-panel .widget-html-content, .fw-panel .jupyter-widget-html-content { line-height: 18px; font-size: 12px; }
.fw-panel .fw-status code { white-space: nowrap; font-size: 12px; }
.fw-panel table { font-size: 12px; }
.fw-panel td, .fw-panel th { padding: 0 6px; text-align: left; }
</style>"""


def style_sheet() -> widgets.Widget:
    """An invisible widget with the style of everything in a box of class fw-panel."""
    return widgets.HTML(STYLE, layout=widgets.Layout(display="none"))


def in_line(*parts: widgets.Widget) -> widgets.Widget:
    """Controls side by side."""
    return widgets.HBox(parts, layout=widgets.Layout(align_items="center"))


def in_columns(*parts: widgets.Widget, last_px: int | None = None) -> widgets.Widget:
    """Controls, a picture that takes the remaining width, and optionally a column of fixed width."""
    last = "" if last_px is None else f" {last_px}px"
    layout = widgets.Layout(
        grid_template_columns=f"{CONTROLS_PX}px minmax(240px, 1fr){last}", grid_gap="6px", width="100%"
    )
    return widgets.GridBox(parts, layout=layout)
