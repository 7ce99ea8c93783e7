"""The study: angle tables and pressure logs in, cycles, hysteresis, comparisons, figures and report out."""
