"""What leaves the workbench: animation, tables, films, reports, and performances on other characters."""

from workbench.export.clip import Clip as Clip
from workbench.export.clip import make_clip as make_clip
from workbench.export.formats import FORMATS as FORMATS
from workbench.export.formats import Exported as Exported
from workbench.export.formats import export_track as export_track
from workbench.export.formats import format_of as format_of
from workbench.export.retargeting import ShapeMapping as ShapeMapping
from workbench.export.retargeting import mapping_by_names as mapping_by_names
from workbench.export.retargeting import read_mapping as read_mapping
from workbench.export.retargeting import retarget as retarget
from workbench.export.retargeting import retarget_surface as retarget_surface
from workbench.export.summary import summary_of as summary_of
from workbench.export.summary import write_summary as write_summary
from workbench.export.tables import write_parameter_table as write_parameter_table
