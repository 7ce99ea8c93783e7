"""Positions to train on: the labels minus the noise of the hand that clicked them."""
