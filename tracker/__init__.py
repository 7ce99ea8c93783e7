"""The instrument: video, geometry, angle, tracking, results, drawing, analysis, synthetic renderer."""

if __name__ != "bendtrack.tracker":
    raise ImportError(f"import this package as bendtrack.tracker, not as {__name__}")
