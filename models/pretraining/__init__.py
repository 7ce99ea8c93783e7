"""Pretraining on rendered actuators, without labels: how the shipped network was made."""
