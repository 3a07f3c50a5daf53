"""Where the bundled data is: beside the package in a checkout, inside it in an installed wheel."""

from pathlib import Path

from workbench.errors import InputError

SAMPLES = {
    "astronaut": "astronaut.png",
    "astronaut-landmarks": "astronaut_landmarks.csv",
    "performance": "performance.mp4",
    "performance-landmarks": "performance_landmarks.csv",
    "performance-truth": "performance_truth.npz",
    "laugh": "laugh.mp4",
    "laugh-landmarks": "laugh_landmarks.csv",
    "laugh-truth": "laugh_truth.npz",
    "glasses": "glasses.mp4",
    "glasses-landmarks": "glasses_landmarks.csv",
    "glasses-truth": "glasses_truth.npz",
    "speech-landmarks": "speech_landmarks.csv",
    "head": "head/head.npz",
    "head-texture": "head/albedo.png",
    "characters": "head/people/characters.toml",
    "parts": "head/people/parts.npz",
}


def samples_folder() -> Path:
    """Folder of the bundled data."""
    package = Path(__file__).resolve().parent
    for folder in (package / "data_samples", package.parent / "data_samples"):
        if (folder / "head").is_dir():
            return folder
    raise InputError("The data_samples folder is missing; install the package again or keep the whole checkout.")


def sample(name: str) -> Path:
    """Path of a bundled file by its short name. Raises `InputError` for a name that does not exist."""
    if name not in SAMPLES:
        raise InputError(f"There is no sample {name!r}; the samples are {', '.join(SAMPLES)}.")
    return samples_folder() / SAMPLES[name]
