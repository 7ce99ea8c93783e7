"""What all commands share: global options, errors in one line, exit statuses.

0 all done; 1 some inputs failed, the others are done; 2 wrong use or an input that cannot be used;
130 interrupted.
"""

from __future__ import annotations

import sys
import traceback
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..errors import BendtrackError
from . import console

INTERRUPTED = 130
_ANYWHERE = ("--quiet", "--debug")


class _Group(TyperGroup):
    """Turns the errors that are a user's to mend into one line and an exit status, for every command."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The global switches count wherever they stand, before or after the command's name."""
        end = args.index("--") if "--" in args else len(args)
        switches = [arg for arg in args[:end] if arg in _ANYWHERE]
        others = [arg for arg in args[:end] if arg not in _ANYWHERE]
        return super().parse_args(ctx, [*switches, *others, *args[end:]])

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise
        except KeyboardInterrupt:
            console.complain("interrupted; what was finished is kept, nothing was left half-written")
            raise typer.Exit(INTERRUPTED) from None
        except (BendtrackError, OSError) as error:
            if console.debugging():
                traceback.print_exception(error)
            console.complain(_one_line(error))
            raise typer.Exit(getattr(error, "exit_status", BendtrackError.exit_status)) from None


app = typer.Typer(
    cls=_Group,
    no_args_is_help=True,
    add_completion=False,
    # Plain help: rich's takes longer to load than all the rest.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    epilog="--quiet and --debug may stand before or after a command.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"bendtrack {version('bendtrack')}")
        raise typer.Exit


@app.callback()
def _bendtrack(
    quiet: Annotated[bool, typer.Option("--quiet", help="Only results, warnings and errors.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Bending angles of soft actuators from plain video, without markers.

    Label about thirty frames, train a network on them, track videos: angle over time, with its uncertainty.
    `bendtrack demo` shows the whole job in a few minutes.
    """
    console.configure(quiet=quiet, debug=debug)
    for stream in (sys.stdout, sys.stderr):
        # A file name or a sign that the terminal's encoding lacks must not end a run.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _one_line(error: BaseException) -> str:
    if isinstance(error, OSError) and not isinstance(error, BendtrackError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__
