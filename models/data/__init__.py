"""Data that networks are trained on: labelled frames, their augmentation, and rendered actuators."""
