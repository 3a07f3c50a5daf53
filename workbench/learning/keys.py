"""Keys of what is kept between two runs: whether a stored search or learning belongs to what is asked for."""

import hashlib
import json
from typing import Any

from workbench.config import Config
from workbench.face import FaceModel
from workbench.objectives import WeightedSum
from workbench.sweeps.clips import SweptClip
from workbench.sweeps.results import settings_read

ANEW = "start again with --overwrite instead of --resume (in a session, without resume=True)"
"""The advice in errors about a stored search or learning that does not fit what is asked for."""


def key_of(config: Config, clip: SweptClip, model: FaceModel, objectives: WeightedSum, **more: Any) -> str:
    """SHA-256 of all that a search or a learning continues from; `more`, plain values, is what they differ in."""
    read = {
        "config": settings_read(config, {"provenance"}),
        "clip": clip.digest,
        "model": model.fingerprint(),
        "objectives": dict(objectives.factors),
        **more,
    }
    return hashlib.sha256(json.dumps(read).encode()).hexdigest()
