"""A photo or clip sent by the browser, for those who sit at a different computer from Python's."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import ipywidgets as widgets

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.frames import IMAGE_SUFFIXES, VIDEO_SUFFIXES
from workbench.landmarks.files import SUFFIXES
from workbench.widgets.panel_page import LARGEST_MB

ACCEPTED = (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES, *SUFFIXES)
SAID = f"a photo, a clip or a landmark file of up to {LARGEST_MB} MB; kept until you leave the page"


class Upload(widgets.FileUpload):
    """Calls `opened` with the path of a file that the user sends, `failed` with errors.

    Shown in the app alone: JupyterLab takes messages of up to 10 MB and uploads files itself.
    """

    def __init__(self, opened: Callable[[Path], None], failed: Callable[[Exception], None]) -> None:
        self._opened, self._failed = opened, failed
        self._folder = tempfile.TemporaryDirectory(prefix="workbench-upload-")
        super().__init__(
            accept=",".join(ACCEPTED), multiple=False, description="Upload", tooltip=SAID,
            layout=widgets.Layout(width="auto", display=None if in_app() else "none"),
        )  # fmt: skip
        self.observe(self._on_upload, "value")

    def close(self) -> None:
        """Remove what was sent."""
        self._folder.cleanup()
        super().close()

    def _on_upload(self, change: dict) -> None:
        try:
            for sent in change["new"]:
                self._opened(stored(Path(self._folder.name), sent["name"], bytes(sent["content"])))
        except (InputError, OSError) as error:
            self._failed(error)
        finally:
            self.value = ()  # otherwise the same file, sent again, would be no change


def stored(folder: Path, name: str, content: bytes) -> Path:
    """A file that was sent, in a new folder inside of `folder`: an earlier one of its name may be open.

    Raises `InputError` for what cannot be opened or is too large.
    """
    name = Path(name.replace("\\", "/")).name
    if Path(name).suffix.lower() not in ACCEPTED:
        raise InputError(f"{name} is not a picture, a video or a landmark file; send one of those.")
    if len(content) > LARGEST_MB * 1e6:
        megabytes = len(content) / 1e6
        raise InputError(
            f"{name} is {megabytes:.0f} MB; uploads are limited to {LARGEST_MB} MB. Open it by its path instead."
        )
    path = Path(tempfile.mkdtemp(dir=folder)) / name
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    return path


def in_app() -> bool:
    """Whether this process serves a page of the app."""
    return os.environ.get("SERVER_SOFTWARE", "").startswith("voila")
