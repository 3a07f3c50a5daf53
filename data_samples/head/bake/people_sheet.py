"""Contact sheet of the characters, for looking at them: neutral, laugh, blink, open mouth, profile.

python data_samples/head/bake/people_sheet.py --out sheets --preview data_samples/head/characters.jpg
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from workbench.face import DressedHead, character_names, load_character, posed_vertices
from workbench.pictures import HeadRenderer, portrait_view

GROUND = (96, 104, 114)
LAUGH = {"mouthSmileLeft": 0.9, "mouthSmileRight": 0.9, "mouthUpperUpLeft": 0.45, "mouthUpperUpRight": 0.45}
LAUGH |= {"jawOpen": 0.28, "cheekSquintLeft": 0.7, "cheekSquintRight": 0.7, "eyeSquintLeft": 0.4, "eyeSquintRight": 0.4}
BLINK = {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}
SIGHTS = {
    "neutral": ({}, 12.0),
    "laugh": (LAUGH, 12.0),
    "blink": (BLINK, 12.0),
    "open mouth": ({"jawOpen": 0.9}, 12.0),
    "profile": ({}, 80.0),
}
"""Weights and yaw in degrees."""
PREVIEW = ("neutral", "laugh")
ZOOM, DOWN_MM = 0.8, -25.0
"""Smaller and higher than a portrait, for hair and shoulders."""


def portraits(dressed: DressedHead, sights: tuple[str, ...], size: int) -> list[np.ndarray]:
    """One picture (RGB) for each sight."""
    person, shape = dressed.person, (size, round(1.15 * size))
    camera, translation = portrait_view(person, shape)
    camera = camera._replace(focal_px=ZOOM * camera.focal_px)
    middle = np.array([0.0, 0.0, (person.neutral[:, 2].min() + person.neutral[:, 2].max()) / 2])
    translation = translation + np.array([0.0, DOWN_MM, 0.0]) + middle
    pictures = []
    with HeadRenderer(person, shape, dressed=dressed) as renderer:
        for sight in sights:
            weights, yaw = SIGHTS[sight]
            expression = np.array([weights.get(name, 0.0) for name in person.expression_names])
            vertices = posed_vertices(person, expression, np.zeros(6))
            rotation = np.array([0.0, np.radians(yaw), 0.0])
            about_the_middle = translation - cv2.Rodrigues(rotation)[0] @ middle
            pictures.append(renderer.render(vertices, camera, rotation, about_the_middle, GROUND))
    return pictures


def main() -> None:
    """Write `characters.png`, and the small preview."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", type=int, default=320, help="width of one picture, pixels")
    parser.add_argument("--preview", type=Path, help="also write a small JPEG here")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = [portraits(load_character(name), tuple(SIGHTS), options.size) for name in character_names()]
    cv2.imwrite(str(options.out / "characters.png"), np.vstack([np.hstack(row) for row in rows])[..., ::-1])
    if options.preview:
        shown = [row[list(SIGHTS).index(PREVIEW[k % 2])] for k, row in enumerate(rows)]
        grid = np.vstack([np.hstack(shown[k : k + 6]) for k in range(0, len(shown), 6)])
        small = cv2.resize(grid, (1200, round(1200 * grid.shape[0] / grid.shape[1])), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(options.preview), small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main()
