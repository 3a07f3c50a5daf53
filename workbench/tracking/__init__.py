"""What a user runs: the FACE IT! tracker, identity calibration, and the records of a run."""

from workbench.tracking.records import FrameFit as FrameFit
from workbench.tracking.records import Track as Track
from workbench.tracking.tracker import FaceTracker as FaceTracker
from workbench.tracking.tracker import FrameObservation as FrameObservation
