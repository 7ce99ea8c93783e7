"""Errors caused by an input, one class for each kind of input.

A message is one line that says what was expected and what came; the command line prints it
and exits with `exit_status`. Bugs are ordinary exceptions and keep their traceback.
"""


class BendtrackError(Exception):
    """An input that cannot be used. Base class of every error that the user can correct."""

    exit_status = 2


class ProjectError(BendtrackError):
    """A project folder or its bendtrack.toml is missing, malformed or inconsistent."""


class VideoError(BendtrackError):
    """A file is not a video that can be read, or a video cannot be written."""


class LabelError(BendtrackError):
    """Labels are missing, malformed, or do not fit the project or its images."""


class AngleError(BendtrackError):
    """An angle definition is unknown or does not fit the keypoints it is given."""


class ResultsError(BendtrackError):
    """A results file is missing, malformed or not written by bendtrack."""


class UnwritableResultsError(ResultsError):
    """Results cannot be written: the folder is read-only, say, or the disk is full."""


class WeightsError(BendtrackError):
    """Starting weights cannot be found, downloaded or fitted to the network."""


class CheckpointError(BendtrackError):
    """A trained network's file is missing, damaged or of another version."""


class TrainingError(BendtrackError):
    """Training cannot start or cannot go on (too few labels, a loss that is not finite)."""


class PressureLogError(BendtrackError):
    """A pressure log cannot be read, or does not say which column, unit or clock it means."""


class StudyError(BendtrackError):
    """A study file is malformed, or a trial of it cannot be put together."""


class MissingPackageError(BendtrackError):
    """A package is not installed that not every use of bendtrack needs."""


class BendtrackWarning(UserWarning):
    """A problem was worked around; the results record where."""


def reason(error: BaseException) -> str:
    """Short reason of an operating-system or library error, to be quoted in brackets in a message.

    Parameters
    ----------
    error : BaseException
        The error that was caught.

    Returns
    -------
    str
        A few words: the first line of its message, at most 200 characters that a terminal shows as they are.
    """
    text = getattr(error, "strerror", None) or str(error)
    line = next(iter(str(text).strip().splitlines()), "") or type(error).__name__
    return "".join(char if char.isprintable() else "?" for char in line)[:200]
