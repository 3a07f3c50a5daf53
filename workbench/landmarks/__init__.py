"""The 68-point scheme, landmark records and files, detectors, and tracking by optical flow."""
