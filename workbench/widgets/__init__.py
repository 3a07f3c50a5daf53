"""Widgets for notebooks: a value and a callback each; the arithmetic lives in functions that need no browser."""

from workbench.widgets.head_view import make_head_view as make_head_view
from workbench.widgets.light_panel import LightPanel as LightPanel
from workbench.widgets.live_panel import LivePanel as LivePanel
from workbench.widgets.opener import SessionOpener as SessionOpener
from workbench.widgets.player import AvatarPlayer as AvatarPlayer
from workbench.widgets.playground import FitPlayground as FitPlayground
from workbench.widgets.playground import adjusted as adjusted
from workbench.widgets.tuning_panel import TuningPanel as TuningPanel
