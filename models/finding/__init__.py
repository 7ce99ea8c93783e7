"""How what networks say becomes keypoints in the frames of a video. Knows networks as functions, and no torch."""
