"""The command line: ``rx90b-flex``."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core
from typer import Option

from rx90b_flex.commands import (
    camera,
    check,
    check_path,
    close_loop,
    demo,
    excite,
    export,
    flexify,
    frf,
    identify,
    import_logs,
    simulate,
    static,
    view,
)  # fmt: skip
from rx90b_flex.commands.shared import say, without_types_of_flags


class _Commands(typer.core.TyperGroup):
    """All commands."""

    def get_params(self, ctx: Any) -> list[Any]:
        return without_types_of_flags(super().get_params(ctx))


app = typer.Typer(
    name="rx90b-flex", cls=_Commands, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


def _print_version(asked: bool) -> None:
    if asked:
        from rx90b_flex import __version__

        say(f"rx90b-flex {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Industrial robots whose drives and joints bend: model, identify, and find what a model lacks."""


_FILE_NAME = re.compile(r"\.(toml|urdf|csv|gz|txt|tsv|parquet|mat|mcap|db3|json|xml|sdf)\b")


class _Command(typer.core.TyperCommand):
    """A command whose numbers are finite, and whose seeds a generator takes."""

    def get_params(self, ctx: Any) -> list[Any]:
        return without_types_of_flags(super().get_params(ctx))

    def invoke(self, ctx: Any) -> Any:
        for parameter in self.params:
            value = ctx.params.get(parameter.name)
            if isinstance(value, float) and not abs(value) < 1e300:
                raise ValueError(f"{parameter.opts[0]} is {value}; expected a finite number")
            if isinstance(value, int) and not isinstance(value, bool) and not -(2**63) <= value < 2**63:
                raise ValueError(f"{parameter.opts[0]} is a number of {len(str(value))} digits; expected a smaller one")
            if parameter.name == "seed" and isinstance(value, int) and value < 0:
                raise ValueError(f"{parameter.opts[0]} is {value}; expected 0 or more")
        try:
            return super().invoke(ctx)
        except ValueError as error:
            raise ValueError(_with_its_place(str(error), ctx)) from error


def _with_its_place(message: str, ctx: Any) -> str:
    """A message that names an option (what the package calls ``count`` is ``--count`` here) or a file.

    Where it does neither, what the command works on stands before it.
    """
    for option in (parameter.opts[0] for parameter in ctx.command.params):
        word = option.removeprefix("--").replace("-", "_")
        if option.startswith("--") and re.match(rf"{word}( is |: )", message):
            return option + message.removeprefix(word)
    values = [ctx.params.get(parameter.name) for parameter in ctx.command.params]
    given = [x for v in values for x in (v if isinstance(v, list | tuple) else [v]) if isinstance(x, str | Path)]
    if not given or "--" in message or _FILE_NAME.search(message) or any(str(x) in message for x in given):
        return message
    return f"{given[0]}: {message}"


COMMANDS: dict[str, Callable[..., None]] = {  # in the order in which a user meets them
    "demo": demo.demo_command,
    "import": import_logs.import_command,
    "check": check.check_command,
    "identify": identify.identify_command,
    "close-loop": close_loop.close_loop_command,
    "simulate": simulate.simulate_command,
    "view": view.view_command,
    "check-path": check_path.check_path_command,
    "excite": excite.excite_command,
    "frf": frf.frf_command,
    "static": static.static_command,
    "camera": camera.camera_command,
    "flexify": flexify.flexify_command,
    "export": export.export_command,
}
for _name, _command in COMMANDS.items():
    app.command(_name, cls=_Command)(_command)


def main() -> None:
    """The command line; see `rx90b_flex.endings.run` for how it ends."""
    from rx90b_flex.endings import run

    usage_error: type[Exception] = typer.BadParameter.__bases__[0]  # the library has it under a name of its own
    sys.exit(run(app, usage_error, "rx90b-flex"))
