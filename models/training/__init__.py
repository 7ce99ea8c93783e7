"""Training a network on the labelled frames of a project."""
