"""From frames to keypoints with trained networks: crops, coarse to fine, tracking, calibration. Imports no torch."""
