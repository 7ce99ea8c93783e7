"""The directive `commands`: one section for each command of the program, made from its own help.

The program's words are not repeated here, so that the page cannot say something else than `--help`.
"""

from __future__ import annotations

import re
from typing import Any

import typer
from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList

PROGRAM = "bendtrack"


class Commands(Directive):
    """`.. commands::` takes no argument."""

    def run(self) -> list[nodes.Node]:
        from bendtrack.tracker.cli import app

        root = typer.main.get_command(app)
        lines: list[str] = []
        for path, command in _all_commands(root, (PROGRAM,)):
            lines += _section(path, command)
        place = nodes.section()
        place.document = self.state.document
        self.state.nested_parse(
            StringList(lines, source="the program's help"), self.content_offset, place, match_titles=True
        )
        return place.children


def _all_commands(group: Any, path: tuple[str, ...]) -> list[tuple[tuple[str, ...], Any]]:
    found: list[tuple[tuple[str, ...], Any]] = []
    for name, command in group.commands.items():
        if getattr(command, "hidden", False):
            continue
        if hasattr(command, "commands"):
            found += _all_commands(command, (*path, name))
        else:
            found.append(((*path, name), command))
    return found


def _section(path: tuple[str, ...], command: Any) -> list[str]:
    context = command.make_context(path[-1], [], resilient_parsing=True)
    context.info_name = " ".join(path)
    title = " ".join(path[1:])
    usage = command.get_usage(context).removeprefix("Usage: ")
    lines = [f".. _command-{'-'.join(path[1:])}:", "", title, "-" * len(title), ""]
    for paragraph in (command.help or "").split("\n\n"):
        lines += [_literal(" ".join(paragraph.split())), ""]
    lines += [".. code-block:: text", "", f"   {' '.join(usage.split())}", ""]
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is None or "--help" in parameter.opts:
            continue
        name, text = record
        if parameter.param_type_name == "argument" or parameter.metavar:
            # The name says it; `<list[str]>` is for programmers.
            name = re.sub(r" <[^>]*>$", "", name)
        lines += [f"``{name}``", f"   {_literal(' '.join(text.split())) or name}", ""]
    return lines


def _literal(text: str) -> str:
    """Help as reStructuredText: what stands between backticks is code, and nothing else is markup."""
    escaped = text.replace("\\", "\\\\").replace("*", r"\*").replace("_", r"\_").replace("|", r"\|")
    parts = escaped.split("`")
    code = [part.replace("\\", "") for part in parts[1::2]]
    parts[1::2] = [f"``{part}``" for part in code]
    return "".join(parts)


def setup(app: Any) -> dict[str, Any]:
    app.add_directive("commands", Commands)
    # The version changes with every build: the page follows the program, not its own file.
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
