from .head_backends import make_head_view as make_head_view
from .light_panel import LightPanel as LightPanel
from .live_panel import LivePanel as LivePanel
from .opener import SessionOpener as SessionOpener
from .player import AvatarPlayer as AvatarPlayer
from .playground import FitPlayground as FitPlayground
from .playground import adjusted as adjusted
from .tuning_panel import TuningPanel as TuningPanel
