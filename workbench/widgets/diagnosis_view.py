"""Why a frame is bad: ranked reasons, each with a change that one click applies and another undoes."""

import html
from collections.abc import Callable

import ipywidgets as widgets

from workbench.config import Config
from workbench.diagnosis.records import Change, Diagnosis, Reason
from workbench.session.history import Step
from workbench.widgets.closing import refill
from workbench.widgets.waiting import OLD

MOST_REASONS = 5
OUTDATED = "Of other settings; ask again."


class DiagnosisView:
    """Reasons, the pull of each landmark group, and the uncertainty of the fit."""

    def __init__(
        self,
        ask: Callable[[], None],
        apply: Callable[[Change], Step[Config] | None],
        take_back: Callable[[Step[Config]], bool],
        height_px: int,
    ) -> None:
        """`apply` returns the configuration with a change, or None if it was refused; `take_back` gets that one and
        returns whether the change was undone."""
        self._apply, self._take_back = apply, take_back
        self.ask = widgets.Button(
            description="Why this frame?", tooltip="look for reasons in the current frame", button_style="primary",
            layout=widgets.Layout(width="auto"),
        )  # fmt: skip
        self.ask.on_click(lambda _button: ask())
        self.status = widgets.HTML()
        self.reasons = widgets.VBox(layout=widgets.Layout(flex="1.2 1 0", min_width="0"))
        self.tables = widgets.HTML(layout=widgets.Layout(flex="1 1 0", min_width="0"))
        self.apply_buttons: list[widgets.Button] = []
        self._said, self._outdated, self._applied = "", False, set[widgets.Button]()
        body = widgets.HBox([self.reasons, self.tables], layout=widgets.Layout(flex="0 0 auto"))
        self.widget = widgets.VBox(
            [widgets.HBox([self.ask, self.status], layout=widgets.Layout(flex="0 0 auto")), body],
            layout=widgets.Layout(height=f"{height_px}px", overflow="auto"),
        )
        self.widget.add_class("fw-diagnosis")

    def say(self, text: str) -> None:
        """Show one line next to the button."""
        self._said = text
        self._show_state()

    def clear(self, text: str = "") -> None:
        """Clear the last diagnosis."""
        self.reasons.children, self.tables.value, self.apply_buttons = (), "", []
        self._outdated = False
        self.say(text)

    def show_outdated(self, outdated: bool) -> None:
        """Grey the shown diagnosis out, with none of its changes to be applied, or show it as before."""
        self._outdated = outdated and bool(self.tables.value)
        self._show_state()

    def _show_state(self) -> None:
        self.status.value = html.escape(f"{self._said} {OUTDATED}" if self._outdated else self._said)
        for part in (self.reasons, self.tables):
            (part.add_class if self._outdated else part.remove_class)(OLD)
        for button in self.apply_buttons:
            button.disabled = self._outdated or button in self._applied

    def show(self, frame: int, diagnosis: Diagnosis) -> None:
        """Show the diagnosis of a frame."""
        reasons = diagnosis.reasons[:MOST_REASONS]
        self.apply_buttons, self._applied, self._outdated = [], set(), False
        self.reasons.layout.display = None if reasons else "none"
        refill(self.reasons, [self._row(k, reason) for k, reason in enumerate(reasons, 1)])
        self.tables.value = pulls_table(diagnosis) + uncertainty_table(diagnosis)
        self.say(f"Frame {frame}: {found_text(len(reasons), diagnosis.flag)}")

    def _row(self, number: int, reason: Reason) -> widgets.Widget:
        text = widgets.HTML(
            f"<b>{number}. {html.escape(reason.title)}</b> <span style='opacity:.7'>(score "
            f"{reason.score:.2f})</span><br>"
            f"{html.escape(reason.evidence)}<br>"
            f"<span style='opacity:.7'>{html.escape(reason.measure)}: {reason.before_percent:.2f} → "
            f"{reason.after_percent:.2f} % of the eye distance with the change</span>"
            if reason.change
            else f"<b>{number}. {html.escape(reason.title)}</b><br>{html.escape(reason.evidence)}",
            layout=widgets.Layout(flex="0 0 auto", margin="0 0 6px 0"),
        )
        if reason.change is None:
            return text
        place = "this frame's points" if reason.change.landmarks else "all frames"
        apply = widgets.Button(
            description=reason.change.label, tooltip=f"change {place}; one undo step", button_style="info",
            layout=widgets.Layout(width="auto", max_width="100%"),
        )  # fmt: skip
        back = widgets.Button(
            description="undo", tooltip="undo this change", disabled=True, layout=widgets.Layout(width="auto")
        )

        applied: list[Step[Config]] = []

        def on_apply(_button) -> None:
            applied[:] = filter(None, [self._apply(reason.change)])
            if applied:
                self._applied.add(apply)
            apply.disabled, back.disabled = bool(applied), not applied

        def on_back(_button) -> None:
            if self._take_back(*applied):
                self._applied.discard(apply)
                apply.disabled, back.disabled = False, True

        apply.on_click(on_apply)
        back.on_click(on_back)
        self.apply_buttons.append(apply)
        row = widgets.VBox([text, widgets.HBox([apply, back])], layout=widgets.Layout(margin="0 0 6px 0"))
        row.add_class("fw-reason")
        return row


def found_text(reasons: int, flag: str) -> str:
    """Why a frame was flagged, if it was, and how many reasons were found."""
    if reasons:
        found = f"{reasons} found, most likely first."
    elif flag:
        found = "none of the causes tried explains it."
    else:
        found = "no reason found; the frame is unremarkable."
    return f"flagged, {flag}; {found}" if flag else found


def pulls_table(diagnosis: Diagnosis) -> str:
    """The changes when each landmark group is left out, as an HTML table."""
    rows = "".join(
        f"<tr><td>{html.escape(pull.group.replace('_', ' '))}</td><td>{pull.rotation_deg:.1f}°</td>"
        f"<td>{pull.translation_mm:.0f} mm</td><td>{pull.distance_percent:.1f} %</td>"
        f"<td>{html.escape(', '.join(f'{name} {change:+.2f}' for name, change in pull.weights[:2]))}</td></tr>"
        for pull in diagnosis.leave_group_out
    )
    return (
        "<b>Pull of each group</b> (change without it)<table><tr><th>group</th><th>head turns by</th>"
        f"<th>moves by</th><th>its points are off by</th><th>weights change most</th></tr>{rows}</table>"
    )


def uncertainty_table(diagnosis: Diagnosis) -> str:
    """Standard deviations of the pose, the least certain weights and unknowns that trade off, as HTML."""
    found = diagnosis.uncertainty
    order = sorted(range(len(found.weights)), key=lambda k: -found.weights[k])[:5]
    names = found.names[6:]
    pitch, yaw, roll = found.rotation_deg
    pairs = "; ".join(f"{first} – {second} {value:+.2f}" for first, second, value in found.pairs[:4]) or "none"
    return (
        f"<b>Uncertainty</b> (noise {found.noise_percent:.2f} % of the eye distance)<br>pose ±: yaw {yaw:.2f}°, pitch "
        f"{pitch:.2f}°, roll {roll:.2f}°, distance {found.translation_mm[2]:.1f} mm; condition {found.condition:.1e}"
        f"<br>least certain weights: {', '.join(f'{names[k]} ±{found.weights[k]:.2f}' for k in order)}"
        f"<br>trade off (|r| > 0.9): {html.escape(pairs)}"
    )
