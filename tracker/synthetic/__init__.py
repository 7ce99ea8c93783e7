"""Rendered actuators with exact truth."""
