"""Fits of one frame under several configurations, made comparable: surfaces in one frame, and what sets them apart."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.config import Config
from workbench.face import posed_vertices
from workbench.session.material import Cancelled
from workbench.session.tuning import TuningSession
from workbench.tracking import FrameFit
from workbench.tracking.unwatched import never


@dataclass(frozen=True, eq=False)
class Compared:
    """The fit of a frame under one configuration, against that under another one."""

    fit: FrameFit
    vertices: Float[np.ndarray, "v 3"]
    """Head frame, millimetres."""
    apart_mm: Float[np.ndarray, "v"]
    """Distance of each vertex from the other fit's, without the pose."""
    turned_deg: float
    moved_mm: float
    """How far the head is turned and moved from the other fit's pose."""


def compared(session: TuningSession, frame: int, config: Config, cancelled: Cancelled = never) -> FrameFit:
    """The fit of a frame under a configuration: that of its run if there was one, else a single one.

    Raises `StoppedError` if cancelled.
    """
    run = session.runs.known(config)
    return session.fit_frame(frame, config=config, cancelled=cancelled) if run is None else run.fits[frame]


def against(session: TuningSession, fit: FrameFit, other: FrameFit) -> Compared:
    """A fit against another one of the same frame; both have a face."""
    vertices, others = (surface(session, each) for each in (fit, other))
    turn = Rotation.from_rotvec(np.array(fit.rotation)) * Rotation.from_rotvec(np.array(other.rotation)).inv()
    return Compared(
        fit=fit,
        vertices=vertices,
        apart_mm=np.linalg.norm(vertices - others, axis=1),
        turned_deg=float(np.degrees(turn.magnitude())),
        moved_mm=float(np.linalg.norm(fit.translation - other.translation)),
    )


def surface(session: TuningSession, fit: FrameFit) -> Float[np.ndarray, "v 3"]:
    """The vertices of a fit, each with the identity of its own configuration."""
    return posed_vertices(session.model.personal(fit.identity), fit.expression, fit.jaw, fit.scale)
