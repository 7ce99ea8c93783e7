"""Odd films: a generator of sound and damaged video files whose angles are known, and what is said of each."""
