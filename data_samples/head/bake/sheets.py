"""Contact sheets of the baked head, for looking at it: neutral, expressions, all units, identities, jaw.

python data_samples/head/bake/sheets.py --head data_samples/head --out sheets
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from render import Asset, Renderer, View, load_asset, load_texture, view

FACES = {
    "neutral": {},
    "smile": {"mouthSmileLeft": 1, "mouthSmileRight": 1, "cheekSquintLeft": 0.6, "cheekSquintRight": 0.6},
    "blink": {"eyeBlinkLeft": 1, "eyeBlinkRight": 1},
    "jaw open": {"jawOpen": 1},
    "surprise": {"jawOpen": 0.5, "browInnerUp": 1, "browOuterUpLeft": 1, "browOuterUpRight": 1}
    | {"eyeWideLeft": 1, "eyeWideRight": 1},
    "anger": {"browDownLeft": 1, "browDownRight": 1, "mouthFrownLeft": 0.8, "mouthFrownRight": 0.8}
    | {"noseSneerLeft": 0.6, "noseSneerRight": 0.6, "eyeSquintLeft": 0.6, "eyeSquintRight": 0.6},
    "pucker": {"mouthPucker": 1},
    "funnel": {"mouthFunnel": 1, "jawOpen": 0.3},
    "jaw left, wink right": {"jawLeft": 1, "eyeBlinkRight": 1},
    "look left": {"eyeLookOutLeft": 1, "eyeLookInRight": 1},
    "tongue": {"jawOpen": 0.6, "tongueOut": 1},
    "open and closed lips": {"jawOpen": 1, "mouthClose": 1},
}


def labelled(picture: np.ndarray, text: str) -> np.ndarray:
    """The picture with a caption."""
    return cv2.putText(picture.copy(), text, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)


def sheet(pictures: list[np.ndarray], columns: int) -> np.ndarray:
    """Pictures in rows, the last row filled up with black."""
    blank = np.zeros_like(pictures[0])
    pictures = pictures + [blank] * (-len(pictures) % columns)
    return np.vstack([np.hstack(pictures[i : i + columns]) for i in range(0, len(pictures), columns)])


def jaw_turned(asset: Asset, vertices: np.ndarray, degrees: float) -> np.ndarray:
    """Jaw opened by linear blend skinning about the jaw joint (positive degrees about +x open it)."""
    angle = np.radians(degrees)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    joint, weights = asset.arrays["joints"][0], asset.arrays["jaw_weights"].astype(float)[:, None]
    return vertices + weights * ((vertices - joint) @ turn.T + joint - vertices)


def close_up(camera: View, factor: float, centre: tuple[float, float, float]) -> View:
    """The same view, enlarged around a head-frame point."""
    shift = camera.rotation @ np.array([0.0, 16.0, 44.0]) - camera.rotation @ np.array(centre)
    return View(camera.rotation, camera.translation + shift, camera.focal * factor, camera.size)


def main() -> None:
    """Write all sheets as PNG, and the small preview.jpg."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--head", type=Path, default=Path(__file__).resolve().parents[1])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--preview", type=Path, help="also write a small JPEG here")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    asset, texture = load_asset(options.head / "head.npz"), load_texture(options.head / "albedo.png")
    large, small, coarse = Renderer(asset, texture, 640), Renderer(asset, texture, 300), Renderer(asset, None, 640)

    def save(name: str, picture: np.ndarray) -> None:
        cv2.imwrite(str(options.out / f"{name}.png"), picture[:, :, ::-1])

    def side(degrees: float, size: int) -> View:
        return view(degrees, 0, 0, size, fill=0.8)

    neutral = [large.draw(asset.neutral, side(degrees, 640)) for degrees in (0, 45, 90)]
    save("neutral", sheet([*neutral, coarse.draw(asset.neutral, side(0, 640))], 2))
    front = side(0, 640)
    places = {"eyes": ((0, -8, -10), 2.6, {}), "mouth": ((0, 75, -20), 4.0, {})}
    places |= {"blink": ((0, 0, -10), 3.0, FACES["blink"]), "teeth": ((0, 75, -20), 3.2, {"jawOpen": 0.6})}
    close = [large.draw(asset.shaped(None, e), close_up(front, zoom, at)) for at, zoom, e in places.values()]
    save("closeups", sheet(close, 2))
    faces = [(name, small.draw(asset.shaped(None, face), side(15, 300))) for name, face in FACES.items()]
    save("expressions", sheet([labelled(picture, name) for name, picture in faces], 4))
    units = [(name, small.draw(asset.shaped(None, {name: 1.0}), side(0, 300))) for name in asset.units]
    save("units", sheet([cv2.resize(labelled(picture, name), (200, 200)) for name, picture in units], 9))
    rng = np.random.default_rng(3)
    draws = [asset.shaped(rng.normal(size=len(asset.identities))) for _ in range(15)]
    poses = [view(rng.uniform(-25, 25), rng.uniform(-8, 8), 0, 300, fill=0.75) for _ in draws]
    save("identities", sheet([small.draw(head, pose) for head, pose in zip(draws, poses, strict=True)], 5))
    opened = [(a, b) for b in (0, 35) for a in (0, 8, 16, 24)]
    jaw = [labelled(small.draw(jaw_turned(asset, asset.neutral, a), side(b, 300)), f"{a} degrees") for a, b in opened]
    save("jaw", sheet(jaw, 4))
    if options.preview:
        row = [neutral[0], neutral[1], *(large.draw(asset.shaped(None, FACES[n]), side(15, 640)) for n in ("smile",))]
        picture = cv2.resize(np.hstack(row), (1200, 400), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(options.preview), picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
