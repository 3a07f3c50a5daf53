"""The Deep Energies stages on the shown frame as a film strip, or the reason why there is none."""

import ipywidgets as widgets

from workbench.session import TuningSession
from workbench.widgets.playground import jpeg

NO_STAGES = (
    "<b>The film strip shows the stages of Deep Energies.</b><br>This configuration fits by FACE IT!; its iterations "
    "are on the page <b>Energy</b>. Choose <i>preset deep</i> under <i>go to…</i> to see each of its stages "
    "drawn on the picture, with the network's landmarks."
)
NO_PICTURES = (
    "<b>The film strip is drawn on the picture.</b><br>There are only landmarks here; open the photo or clip itself."
)
NO_FACE = "No face in frame {frame}, so there are no stages."
DRAWING = "Fitting the stages of Deep Energies on frame {frame} and drawing them …"


class FilmStrip(widgets.VBox):
    """A sentence, or the strip of a frame, drawn by `show_frame` from any thread."""

    def __init__(self, session: TuningSession) -> None:
        self._session = session
        self.note = widgets.HTML()
        self.image = widgets.Image(
            format="jpeg", layout=widgets.Layout(max_width="100%", object_fit="contain", display="none")
        )
        self.image.add_class("fw-film-strip")
        super().__init__([self.note, self.image])
        self.show_config()

    def show_config(self) -> None:
        """Update from the configuration, and say why if there is no strip."""
        if not self._session.config.traits.renders:
            self._say(NO_STAGES)
        elif not self._session.material.pictures.real:
            self._say(NO_PICTURES)
        elif self.image.layout.display == "none":
            self._say("Fitting the stages of Deep Energies …")

    def show_frame(self, frame: int) -> None:
        """Draw the stages of a frame, if the configuration has them."""
        self.show_config()
        if not self._session.config.traits.renders or not self._session.material.pictures.real:
            return
        self.note.value = DRAWING.format(frame=frame)
        strip = self._session.stage_strip(frame)
        if strip is None:
            self._say(NO_FACE.format(frame=frame))
            return
        self.image.value, self.image.layout.display = jpeg(strip), None
        self.note.value = ""

    def _say(self, why: str) -> None:
        self.note.value, self.image.value, self.image.layout.display = why, b"", "none"
