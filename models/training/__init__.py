"""Training a cascade on the labelled frames of a project."""
