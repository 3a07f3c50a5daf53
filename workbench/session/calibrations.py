"""Calibrations of shots, cached by everything that they depend on."""

import threading

from workbench.config import Config
from workbench.session.material import Material
from workbench.session.observed_frames import ObservedFrames
from workbench.tracker import calibration_window, identity_key
from workbench.tracking.fitting import Calibrated, Fitter


class Calibrations:
    """Identity and appearance of each shot under the requested configurations. Thread-safe."""

    def __init__(self, material: Material, frames: ObservedFrames) -> None:
        self._material, self._frames = material, frames
        self._kept: dict[tuple[int, str], Calibrated] = {}
        self._lock = threading.Lock()

    def of_shot(self, shot: int, config: Config, fitter: Fitter, coarse: bool = False) -> Calibrated:
        """The identity and appearance shared by the frames of a shot, calibrated on its first frames.

        `fitter` must already follow `config`. `coarse` accepts an identity that an earlier configuration calibrated on
        the shot.
        """
        nothing = Calibrated(fitter.mean_identity(), {})
        if not fitter.calibrates:
            return nothing
        material = self._material
        frames = material.shots[shot]
        seen = material.observations[frames.start : frames.stop]
        window = calibration_window(seen, 1 if material.stills else config.identity.window)
        window = [self._frames.observation(item.index, config, pictured=True) for item in window]
        if not any(observation.landmarks is not None for observation in window):
            return nothing
        key = (shot, identity_key(config, fitter.plan.camera, window))
        with self._lock:
            if coarse and len(frames) > 1 and key not in self._kept:
                earlier = [found for (number, _), found in self._kept.items() if number == shot]
                if earlier:
                    return earlier[-1]._replace(starts={})
            if key not in self._kept:
                self._kept[key] = fitter.calibrate(window, 1 if material.stills else config.identity.frames)
                while len(self._kept) > 4 * len(material.shots) + 32:
                    self._kept.pop(next(iter(self._kept)))
            return self._kept[key]
