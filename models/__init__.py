"""The network: training, evaluation, checkpoints, inference. torch is imported here and nowhere else."""

if __name__ != "bendtrack.models":
    raise ImportError(f"import this package as bendtrack.models, not as {__name__}")
