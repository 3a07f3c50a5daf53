"""The drop-down of who the head is drawn as."""

import ipywidgets as widgets

from workbench.face import DressedHead, FaceModel, character_names, dressed_as
from workbench.face.characters import PLAIN
from workbench.session import TuningSession


class CharacterChoice:
    """Sets `head.character` of the session, and follows it where undo, snapshots or files change it."""

    def __init__(self, session: TuningSession, model: FaceModel) -> None:
        self._session, self._model = session, model
        self._name = session.config.head.character
        people = character_names() if model.name == "default-head" else ()
        self.widget = widgets.Dropdown(
            options=list(dict.fromkeys([PLAIN, *people, self._name])), value=self._name,
            tooltip="who the head is drawn as", layout=widgets.Layout(width="88px"),
        )  # fmt: skip
        self.widget.observe(self._on_choice, "value")

    @property
    def dressed(self) -> DressedHead | None:
        """The head as it is to be drawn; None: plain."""
        return dressed_as(self._name, self._model)

    def follow(self) -> bool:
        """Show what the configuration says; whether that is another character than before."""
        wanted = self._session.config.head.character
        if wanted == self._name:
            return False
        self._name = wanted
        if wanted not in self.widget.options:
            self.widget.options = [*self.widget.options, wanted]
        self.widget.value = wanted
        return True

    def _on_choice(self, change: dict) -> None:
        if change["new"] != self._session.config.head.character:
            self._session.set("character", "head.character", head={"character": change["new"]})
