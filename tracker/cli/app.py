"""What all commands share: global options, help in groups, errors in one line, exit statuses.

0 all done; 1 some inputs failed, the others are done; 2 wrong use or an input that cannot be used;
130 interrupted.
"""

from __future__ import annotations

import sys
import traceback
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from ..errors import BendtrackError
from . import console
from .wrong_use import USAGE_ERROR, WrongUse, in_one_line, in_our_words, is_help

INTERRUPTED = 130
_ANYWHERE = ("--quiet", "--debug")

COMMAND_GROUPS: dict[str, tuple[str, ...]] = {
    "To try it": ("demo", "angle", "render", "doctor"),
    "A project and its labels": ("new", "frames", "label", "labels", "import", "export"),
    "A network": ("train", "evaluate", "pretrain"),
    "Bending angles": ("track", "live"),
    "A study": ("analyze",),
}
"""The commands as --help lists them."""

_NEEDS_TORCH = ("torch", "torchvision", "nncf")


class _Group(TyperGroup):
    """Turns the errors that are a user's to mend into one line and an exit status, for every command."""

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **more: Any) -> Any:
        """Take the words before the command's name apart; what is wrong with them is one line."""
        try:
            with in_our_words(args):
                return super().make_context(info_name, args, *rest, **more)
        except WrongUse as error:
            console.complain(str(error))
            raise typer.Exit(BendtrackError.exit_status) from None

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The global switches count wherever they stand, before or after the command's name."""
        end = args.index("--") if "--" in args else len(args)
        switches = [arg for arg in args[:end] if arg in _ANYWHERE]
        others = [arg for arg in args[:end] if arg not in _ANYWHERE]
        return super().parse_args(ctx, [*switches, *others, *args[end:]])

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands in groups, each with the first sentence of its help."""
        names = [name for group in COMMAND_GROUPS.values() for name in group]
        width = max(map(len, names))
        for title, group in COMMAND_GROUPS.items():
            # Read from the left as one column, however long the names of a group are.
            rows = [
                (name.ljust(width), command.get_short_help_str(limit=200))
                for name in group
                if (command := self.get_command(ctx, name)) is not None
            ]
            with formatter.section(title):
                formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise
        except KeyboardInterrupt as interrupt:
            console.complain(
                str(interrupt) or "interrupted; finished files are kept, no file is half-written"
            )
            raise typer.Exit(INTERRUPTED) from None
        except ModuleNotFoundError as error:
            missing = (error.name or "").partition(".")[0]
            if missing not in _NEEDS_TORCH:
                raise
            from ..extras import install_command

            _tell(error, f"this needs {missing}, which is not installed: {install_command()}")
            raise typer.Exit(BendtrackError.exit_status) from None
        except USAGE_ERROR as error:
            if is_help(error):
                raise
            _tell(error, in_one_line(error))
            raise typer.Exit(BendtrackError.exit_status) from None
        except (BendtrackError, OSError) as error:
            _tell(error, _one_line(error))
            raise typer.Exit(getattr(error, "exit_status", BendtrackError.exit_status)) from None


class Command(TyperCommand):
    """A command whose help calls arguments what people write, without types and braces."""

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **more: Any) -> Any:
        """Take the command's words apart.

        Raises
        ------
        WrongUse
            Some word is not what the command expects.
        """
        with in_our_words(args, f"bendtrack {info_name}"):
            return super().make_context(info_name, args, *rest, **more)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """[OPTIONS] and the arguments, called as in the help below."""
        return ["[OPTIONS]", *(_called(argument) for argument in self._arguments(ctx))]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """List arguments and options, each with its sentence."""
        arguments = [(_called(argument), _explained(argument)) for argument in self._arguments(ctx)]
        if arguments:
            with formatter.section("Arguments"):
                formatter.write_dl(arguments)
        options = [p for p in self.get_params(ctx) if p.param_type_name == "option"]
        records = [record for p in options if (record := p.get_help_record(ctx)) is not None]
        with formatter.section("Options"):
            formatter.write_dl(records)

    def _arguments(self, ctx: Any) -> list[Any]:
        return [p for p in self.get_params(ctx) if p.param_type_name == "argument"]


def _called(argument: Any) -> str:
    return str(argument.metavar or argument.name.upper())


def _explained(argument: Any) -> str:
    default = argument.show_default
    return f"{argument.help}  [default: {default}]" if isinstance(default, str) else str(argument.help)


app = typer.Typer(
    cls=_Group,
    no_args_is_help=True,
    # Plain help: rich's takes longer to load than all the rest.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    epilog="--quiet and --debug may stand before or after a command. `bendtrack COMMAND --help` explains a command.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"bendtrack {version('bendtrack')}")
        raise typer.Exit


@app.callback()
def _bendtrack(
    context: typer.Context,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print only results, warnings and errors.")] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Print details, and the traceback of an error.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Bending angles of soft actuators from plain video, without markers.

    Label about thirty frames, train a network on them, track videos: angle over time, with its uncertainty.
    `bendtrack demo` shows the whole job in a few minutes.
    """
    words = () if context.invoked_subcommand is None else (context.invoked_subcommand,)
    console.configure(quiet=quiet, debug=debug, words=words)
    for stream in (sys.stdout, sys.stderr):
        # A file name or a sign that the terminal's encoding lacks must not end a run.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _tell(error: BaseException, line: str) -> None:
    if console.debugging():
        traceback.print_exception(error)
    console.complain(line)


def _one_line(error: BaseException) -> str:
    if isinstance(error, OSError) and not isinstance(error, BendtrackError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__
