"""The picture of the guide *Export*: laugh, squint, smirk and pucker of the bundled clips, played by two characters.

    python data_samples/retargeting_sheet.py --out data_samples/retargeting.jpg

Tracks the clips from their pictures under a preset; each column is the frame of an expression, which the
clip's truth tells: the actor above, then the characters.
"""

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

from workbench import load_default_head
from workbench.config import DEFAULT_PRESET, preset
from workbench.export import retarget
from workbench.face import DressedHead, load_character, posed_vertices
from workbench.frames import open_frames
from workbench.pictures import HeadRenderer, portrait_view
from workbench.pipeline import track
from workbench.plots import close_up
from workbench.samples import sample
from workbench.tracking import Track

SIGHTS = {
    "laugh": ("laugh", 53),
    "squint": ("performance", 131),
    "smirk": ("performance", 76),
    "pucker": ("performance", 159),
}
"""Clip and frame, where the expression is strongest."""
CHARACTERS = ("sofia", "kofi")
SIDE_PX = 300
MARGIN = 1.5
"""Width of the actor's square in widths of the face: so that it ends inside the frame."""
GROUND = (96, 104, 114)
ZOOM, DOWN_MM = 0.95, -15.0
"""Smaller and higher than a portrait, for hair and shoulders."""


def main() -> None:
    """Track, retarget, draw and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--preset", default=DEFAULT_PRESET)
    options = parser.parse_args()
    clips = {clip for clip, _ in SIGHTS.values()}
    tracks = {clip: tracked(clip, options.preset) for clip in sorted(clips)}
    rows = [np.hstack([photo(tracks[clip], clip, frame) for clip, frame in SIGHTS.values()])]
    for name in CHARACTERS:
        rows.append(np.hstack(portraits(load_character(name), tracks)))
    cv2.imwrite(str(options.out), np.vstack(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


def tracked(clip: str, name: str) -> Track:
    """The fits of a bundled clip."""
    with tempfile.TemporaryDirectory() as folder:
        return track(sample(clip), folder, load_default_head(), preset(name), pictures=False).track


def photo(found: Track, clip: str, frame: int) -> np.ndarray:
    """The actor's face in a frame."""
    picture = next(each.picture for each in open_frames(sample(clip)).iterate() if each.index == frame)
    return close_up(picture, found[frame], SIDE_PX, margin=MARGIN)[0]


def portraits(dressed: DressedHead, tracks: dict[str, Track]) -> list[np.ndarray]:
    """A character with each expression, turned as the actor is."""
    person, shape = dressed.person, (SIDE_PX, SIDE_PX)
    camera, translation = portrait_view(person, shape)
    camera = camera._replace(focal_px=ZOOM * camera.focal_px)
    middle = np.array([0.0, 0.0, (person.neutral[:, 2].min() + person.neutral[:, 2].max()) / 2])
    translation = translation + np.array([0.0, DOWN_MM, 0.0]) + middle
    played = {clip: retarget(found, dressed.model) for clip, found in tracks.items()}
    pictures = []
    with HeadRenderer(person, shape, dressed=dressed) as renderer:
        for clip, frame in SIGHTS.values():
            vertices = posed_vertices(person, played[clip].expression[frame], np.zeros(6))
            rotation = played[clip].rotation[frame]
            about_the_middle = translation - cv2.Rodrigues(rotation)[0] @ middle
            pictures.append(renderer.render(vertices, camera, rotation, about_the_middle, GROUND))
    return pictures


if __name__ == "__main__":
    main()
