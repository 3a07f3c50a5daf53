"""What a tuning panel is made of, apart from its first frame; importing it takes seconds."""

from workbench.session import FittedHead as FittedHead
from workbench.widgets.changes_page import ChangesPage as ChangesPage
from workbench.widgets.clip_bar import ClipBar as ClipBar
from workbench.widgets.clip_views import ClipViews as ClipViews
from workbench.widgets.compare_page import ComparePage as ComparePage
from workbench.widgets.controls import Controls as Controls
from workbench.widgets.export_dialog import ExportDialog as ExportDialog
from workbench.widgets.film_strip import FilmStrip as FilmStrip
from workbench.widgets.frame_diagnosis import FrameDiagnosis as FrameDiagnosis
from workbench.widgets.head_column import HeadColumn as HeadColumn
from workbench.widgets.history_bar import HistoryBar as HistoryBar
from workbench.widgets.iterations import Iterations as Iterations
from workbench.widgets.landmark_tools import LandmarkTools as LandmarkTools
from workbench.widgets.panel_page import PanelPage as PanelPage
from workbench.widgets.shared_scale import SharedScale as SharedScale
from workbench.widgets.slow_jobs import SlowJobs as SlowJobs
from workbench.widgets.status_line import StatusLine as StatusLine
from workbench.widgets.sweep_page import SweepPage as SweepPage
from workbench.widgets.time_page import TimePage as TimePage
from workbench.widgets.transport import Transport as Transport
from workbench.widgets.tune_page import TunePage as TunePage
