"""The command line: a shell over the front door (`bendtrack/`), which is imported inside each command.

A command takes its arguments apart and calls plain functions; what they report is printed here and nowhere else.
"""

import sys
import warnings
from collections.abc import Callable

from .angle_command import angle
from .app import Command, app
from .demo_command import demo
from .doctor_command import doctor
from .frame_commands import frames, labels
from .label_command import label
from .live_command import live
from .network_commands import evaluate, train
from .pretrain_command import pretrain
from .project_commands import export_labels, import_labels, new
from .render_command import render
from .study_commands import analyze
from .track_command import track

__all__ = ["main"]

_COMMANDS: dict[str, Callable[..., None]] = {
    "demo": demo,
    "new": new,
    "frames": frames,
    "label": label,
    "import": import_labels,
    "export": export_labels,
    "train": train,
    "evaluate": evaluate,
    "track": track,
    "live": live,
    "angle": angle,
    "analyze": analyze,
    "render": render,
    "pretrain": pretrain,
    "doctor": doctor,
}
for _name, _command in _COMMANDS.items():
    app.command(_name, cls=Command)(_command)
app.add_typer(labels, name="labels")


def main() -> None:
    """Entry point of the installed command `bendtrack`."""
    if not sys.warnoptions and "--debug" not in sys.argv:
        warnings.simplefilter("ignore")  # libraries' words to programmers; ours come through `console`
    app()
