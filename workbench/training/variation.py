"""How far training pictures stray from clean renders: the numbers of `augment.py` and of its twins for whole batches.

Shares are of all pictures, or of those to which the preceding effect applies. A deviation with a largest amount belongs
to a normal distribution that is cut off there; other pairs are the ends of a uniform one.
"""

# Framing, about the crop that a detector would ask for.
MIRRORED_SHARE = 0.5
NEARLY_UPRIGHT, UPRIGHT_ROLL_DEG, ANY_ROLL_DEG = 0.85, (14.0, 40.0), (-60.0, 60.0)
SCALE_LOGARITHM, SHIFT = (0.13, 0.35), (0.06, 0.17)
"""The crop's side, and where its centre is, in sides."""

# Light on the head.
KEPT_LIGHT, MOST_GAIN = 0.2, 5.0
"""Share of the pictures that keep the scene's light, and how much brighter the others get at most."""
EXPOSED = (60.0, 190.0)
"""Mean grey values that automatic exposure may give a face."""
HEAD_COLOUR = 0.04
"""Deviation of each channel's factor."""

# Around and before the head.
FACELESS, BYSTANDERS, BARE, OCCLUDED, SHADOWED = 0.04, 0.12, 0.15, 0.35, 0.35
"""Shares of the pictures: without a face, with another behind, without clothes, with an occluder, partly in shadow."""
BYSTANDER_PX = (70.0, 260.0)
"""Sides of their renders in a crop of `CROP_SIDE` pixels."""
CLOTH_GRAIN = 0.1
SHADOW_PLACE, SHADOW_STEEPNESS_LOGARITHM, SHADOW_LIGHT = (-0.5, 0.5), (0.5, 4.0), (-0.7, 0.5)

# Lens, sensor and codec. Pixels are those of a crop of `CROP_SIDE` pixels.
DEVELOPED, DIM, OUT_OF_FOCUS, MOVED, COARSE, NOISY, COMPRESSED = 0.9, 0.1, 0.4, 0.15, 0.45, 0.6, 0.5
"""Shares of the pictures with other colours and contrast, too little light, blur, motion blur, a lower resolution,
noise, compression."""
GAMMA_LOGARITHM, GAIN_LOGARITHM, BLACK, COLOUR_LOGARITHM, CONTRAST_LOGARITHM = 0.28, 0.2, 0.06, 0.08, 0.25
"""Deviations of a developed picture's exponent, brightness, black point, channels and contrast."""
GREY, SATURATION = 0.14, (0.3, 1.5)
WHITE_PHOTONS, BRIGHTENED = (30.0, 400.0), (0.4, 1.1)
"""Too little light: photons of a white pixel, and how much of its brightness the picture gets back."""
FOCUS_PX, MOTION_PX = (0.4, 2.6), (3, 13)
LEAST_RESOLUTION_PX, COARSE_DAMAGED, COARSE_NOISE = 48.0, 0.5, (0.0, 10.0)
"""The lowest resolution; the share of lowered ones with noise and compression of their own, and how much noise."""
SMOOTHLY_ENLARGED = 0.6
"""Share enlarged linearly; the others cubically."""
NOISE, GRAINY, GRAIN_PX = (1.0, 18.0), 0.4, 0.8
"""Deviations, logarithms uniform; share of the noise that has a grain, and its width."""
QUALITY = (12.0, 90.0)
"""JPEG's."""
