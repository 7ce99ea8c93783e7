"""Fitting a network to one video without labels: self-training and prediction averaging."""
