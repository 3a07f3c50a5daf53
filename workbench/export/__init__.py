"""What leaves the workbench: tables and the summary of a run."""

from workbench.export.summary import summary_of as summary_of
from workbench.export.summary import write_summary as write_summary
from workbench.export.tables import write_parameter_table as write_parameter_table
