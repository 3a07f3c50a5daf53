from .fitter import FrameContext as FrameContext
from .fitter import FrameFitter as FrameFitter
from .fitter import FrameObservation as FrameObservation
from .fitter import StageTrace as StageTrace
from .records import FrameFit as FrameFit
from .records import Track as Track
from .track_reader import TrackReader as TrackReader
from .tracker import FaceTracker as FaceTracker
