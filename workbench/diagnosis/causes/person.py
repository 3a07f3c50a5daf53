"""Causes shared by a whole shot: the identity and the lens."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from workbench.diagnosis.records import Change
from workbench.diagnosis.trial import Finding, Trial
from workbench.landmarks.scheme import face_size
from workbench.planning import camera_plan
from workbench.tracker import calibration_window
from workbench.tracking import FrameFit

LEAST_IDENTITY_GAIN = 0.2
"""Minimum fraction of the shot's unexplained evidence that another face must explain."""
LONGEST_WINDOW = 1000
"""The most that `identity.window` takes."""
LEAST_FOCAL_RATIO = 1.06
"""Ratio of the cost under the configured lens to that under the best lens above which the lens is doubted."""
SURE_FOCAL_RATIO = 1.2
BRACKET = 1.015
OWN_TROUBLE = 30.0
"""Nats above the usual at which a frame has a problem that the shot does not have."""
NARROWEST_FOV_DEG = 10.0
"""Narrowest field of view proposed; a longer lens makes no difference."""
UNBRACKETED_FOCAL_RATIO = 1.18
"""The same if the cost keeps falling towards long lenses, because systematic detector errors look orthographic."""
LEAST_FOCAL_FACTOR = 1.7
"""Smallest factor reported: a guessed lens is rarely closer to the true one, and does little harm within it."""
LEAST_FOCAL_COST = 10.0


def wrong_identity(trial: Trial) -> Iterator[Finding]:
    """Another face, calibrated on the shot's sound frames, explains the frames better.

    The change is a setting that brings such a face; there may be none, as where half of the shot is bad.
    """
    identity = trial.reference.identity
    if identity is None or len(identity) == 0:
        return
    usual = _usual_nats(trial, trial.case.context.identity)
    best = _Face(trial, usual, Change("", calibrate=True, identity=identity))
    if not best.better:
        return
    change = recalibration(trial)
    reached = None if change is None else _Face(trial, usual, change)
    found = reached if reached is not None and reached.better else best
    before, then = trial.error_percent(trial.fit), trial.error_percent(found.fit)
    frames = f"{len(trial.reference.frames)} frames spread over the shot"
    if found is reached:
        evidence = "Calibrated on the whole shot, the face changes the error here from {before} to {after} % of the "
        evidence += "eye distance, and improves the other frames as well."
    else:
        evidence = f"With a face calibrated on the sound ones of {frames} the error here would be {then:.1f} % of the "
        evidence += f"eye distance instead of {before:.1f}, and smaller in the other frames as well. Settings do not "
        evidence += "bring it: leave out the frames with bad points (--frames), or correct these."
    yield Finding(
        code="wrong_identity",
        title="The face shape is not this person's",
        evidence=evidence,
        change=change if found is reached else None,
        gain=found.gain,
        before_percent=before,
        after_percent=then if found is reached else before,
        numbers={
            "distance_sigma": float(np.linalg.norm(found.identity - trial.case.context.identity)),
            "shot_before_nats": usual,
            "shot_after_nats": found.usual,
        },
        outranks=("jaw_disagrees", "group_biased", "occluded", "weights_at_bounds", "pose_expression_tradeoff"),
    )


class _Face:
    """Another face: what it explains in the frame and in the shot."""

    def __init__(self, trial: Trial, usual_now: float, change: Change):
        self.identity = change.identity
        self.fit = trial.refit(change)
        self.usual = _usual_nats(trial, change.identity)
        self.gain = min(trial.gain(self.fit, 2.0), usual_now - self.usual)
        self.better = self.gain > 0.0 and self.gain >= LEAST_IDENTITY_GAIN * usual_now


def recalibration(trial: Trial) -> Change | None:
    """The change that calibrates the identity on the whole shot; None where it is so already."""
    config, shot = trial.case.config, trial.case.shot
    window = min(len(shot), LONGEST_WINDOW)
    wanted = {"window": window} if window > config.identity.window else {}
    if not config.identity.calibrate:
        wanted["calibrate"] = True
    if not wanted:
        return None
    changed = config.changed(identity=wanted)
    identity = trial.reference.identity_of(calibration_window(shot, changed.identity.window), changed)
    return Change(
        "Calibrate the identity on the whole shot", config={"identity": wanted}, calibrate=True, identity=identity
    )


def _usual_nats(trial: Trial, identity: Float[np.ndarray, "i"]) -> float:
    """Median over the shot's sound frames, each fitted with this identity on its own."""
    known = trial.reference.usual_fits if identity is trial.reference.identity else trial.reference.fits(identity)
    return float(np.median([_nats(trial, fit) for fit in known]))


def wrong_focal(trial: Trial) -> Iterator[Finding]:
    """Faces and poses of the whole shot fit better under another focal length."""
    config = trial.case.config
    if config.camera.matrix is not None or config.camera.rig or trial.reference.focal_costs is None:
        return
    factors, costs = (np.array(part) for part in zip(*trial.reference.focal_costs.items(), strict=True))
    here = trial.reference.focal_costs[1.0]
    factor, lowest = best_factor(factors, costs)
    if lowest <= 0.0:  # no point counts
        return
    ratio = here / lowest
    low = int(np.argmin(costs))
    bracketed = 0 < low < len(costs) - 1 and min(costs[low - 1], costs[low + 1]) > BRACKET * costs[low]
    least = LEAST_FOCAL_RATIO if bracketed else UNBRACKETED_FOCAL_RATIO
    if max(factor, 1.0 / factor) < LEAST_FOCAL_FACTOR or ratio < least or here - lowest < LEAST_FOCAL_COST:
        return
    if not bracketed:
        factor = float(np.clip(factor, 0.5, 2.0))
    fov = max(fov_with(config.camera.fov_deg, factor), NARROWEST_FOV_DEG)
    changed = config.changed(camera={"fov_deg": fov})
    identity = trial.reference.identity_under(changed)
    label, sections = f"Set the field of view to {fov:.0f}°", {"camera": {"fov_deg": fov}}
    if not config.identity.calibrate:
        label, sections = f"{label} and calibrate the identity", {**sections, "identity": {"calibrate": True}}
    change = Change(label, config=sections, calibrate=True, identity=identity)
    fit = trial.refit(change)
    size = trial.case.observation.image_size
    focal = float(np.mean(camera_plan(config).of(size).focal_px))
    yield Finding(
        code="wrong_focal",
        title="The focal length does not suit the face",
        evidence=f"Over {len(trial.reference.frames)} frames of the shot, the cost is "
        f"{100 * (1 - 1 / ratio):.0f} % lower with a focal length of {focal * factor:.0f} px than with {focal:.0f} px "
        f"(a field of view of {fov:.0f}° instead of {config.camera.fov_deg:.0f}°).",
        change=change,
        gain=trial.gain(fit),
        before_percent=trial.reference.focal_error_percent(here),
        after_percent=trial.reference.focal_error_percent(lowest),
        direct=_own_part(trial, fit) * float(np.interp(ratio, [LEAST_FOCAL_RATIO, SURE_FOCAL_RATIO], [0.5, 0.95])),
        measure="shot-wide error with the face shape fitted to each lens",
        numbers={"factor": factor, "fov_deg": fov, "cost_ratio": float(ratio)},
        outranks=("jaw_disagrees", "group_biased", "weights_at_bounds", "pose_expression_tradeoff"),
    )


def _own_part(trial: Trial, fit: FrameFit) -> float:
    """Fraction of a frame's error attributable to the lens: 1 for a frame like the others, less for an outlier."""
    if trial.excess < OWN_TROUBLE:
        return 1.0
    return float(np.clip(0.4 + trial.gain(fit) / trial.excess, 0.4, 1.0))


def best_factor(factors: np.ndarray, costs: np.ndarray) -> tuple[float, float]:
    """The focal factor with the lowest cost, and that cost, from a parabola in the logarithm around the minimum."""
    steps, low = np.log(factors), int(np.argmin(costs))
    if not 0 < low < len(costs) - 1:
        return float(factors[low]), float(costs[low])
    near = slice(low - 1, low + 2)
    a, b, c = np.polyfit(steps[near] - steps[low], costs[near], 2)
    move = float(np.clip(-b / (2.0 * a), -0.35, 0.35)) if a > 0.0 else 0.0
    return float(np.exp(steps[low] + move)), float(a * move * move + b * move + c)


def fov_with(fov_deg: float, factor: float) -> float:
    """The field of view after multiplying the focal length, degrees, rounded to a tenth."""
    return round(float(np.degrees(2.0 * np.arctan(np.tan(np.radians(fov_deg) / 2.0) / factor))), 1)


def _nats(trial: Trial, fit: FrameFit) -> float:
    percent = 100.0 * fit.residuals_px / face_size(fit.observed)
    return trial.total(np.log1p((percent / trial.reference.residual_percent) ** 2))
