"""Networks that find landmarks in pictures: heat maps, the soft-argmax, and the crop they see, all differentiable."""

from workbench.networks.crop import INPUT_SIDE as INPUT_SIDE
from workbench.networks.crop import CropBox as CropBox
from workbench.networks.crop import crop_and_resize as crop_and_resize
from workbench.networks.crop import crop_box as crop_box
from workbench.networks.crop import fan_box as fan_box
from workbench.networks.crop import fan_box_from_landmarks as fan_box_from_landmarks
from workbench.networks.crop import reduction_for as reduction_for
from workbench.networks.crop import to_crop as to_crop
from workbench.networks.crop import to_picture as to_picture
from workbench.networks.landmark_chain import HeatMapNetwork as HeatMapNetwork
from workbench.networks.landmark_chain import NetworkLandmarks as NetworkLandmarks
from workbench.networks.landmark_chain import landmarks_of as landmarks_of
from workbench.networks.landmark_network import Calibration as Calibration
from workbench.networks.landmark_network import LandmarkNetwork as LandmarkNetwork
from workbench.networks.landmark_network import read_landmark_network as read_landmark_network
from workbench.networks.landmark_network import save_landmark_network as save_landmark_network
from workbench.networks.soft_argmax import BETA as BETA
from workbench.networks.soft_argmax import patch_mass as patch_mass
from workbench.networks.soft_argmax import soft_argmax as soft_argmax
from workbench.networks.weights import Weights as Weights
from workbench.networks.weights import named_arrays as named_arrays
from workbench.networks.weights import read_weights as read_weights
from workbench.networks.weights import write_weights as write_weights
