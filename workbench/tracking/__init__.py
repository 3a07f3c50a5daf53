"""What a user runs: the FACE IT! tracker, identity calibration, and the records of a run."""

from workbench.tracking.fitter import FrameContext as FrameContext
from workbench.tracking.fitter import FrameFitter as FrameFitter
from workbench.tracking.fitter import FrameObservation as FrameObservation
from workbench.tracking.fitter import StageTrace as StageTrace
from workbench.tracking.records import FrameFit as FrameFit
from workbench.tracking.records import Track as Track
from workbench.tracking.tracker import FaceTracker as FaceTracker
