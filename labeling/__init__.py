"""What people click: the label store and foreign label formats."""

if __name__ != "bendtrack.labeling":
    raise ImportError(f"import this package as bendtrack.labeling, not as {__name__}")
