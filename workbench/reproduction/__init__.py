"""What the papers' figures and tables are remade from: published data sets, their layouts and their protocols."""

from workbench.reproduction.boston import BostonSequence as BostonSequence
from workbench.reproduction.boston import MeanErrors as MeanErrors
from workbench.reproduction.boston import PoseErrors as PoseErrors
from workbench.reproduction.boston import boston_camera as boston_camera
from workbench.reproduction.boston import mean_errors as mean_errors
from workbench.reproduction.boston import pose_errors as pose_errors
from workbench.reproduction.boston import read_sequence as read_sequence
from workbench.reproduction.boston import read_set as read_set
from workbench.reproduction.boston import read_truth as read_truth
from workbench.reproduction.boston import write_truth as write_truth
