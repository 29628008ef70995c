"""The command `tarc`: its subcommands, warnings and errors."""

import os
import sys
import warnings
from typing import Annotated

import typer

from tarc.cli.certify import certify
from tarc.cli.compare import compare
from tarc.cli.demo import demo
from tarc.cli.design import design
from tarc.cli.diagnose import diagnose
from tarc.cli.export import export, verify_export
from tarc.cli.identify import identify
from tarc.cli.replay import replay
from tarc.cli.ros2 import app as ros2
from tarc.cli.run import run
from tarc.cli.run_live import run_live
from tarc.cli.show import show
from tarc.cli.studio import studio
from tarc.cli.study import study
from tarc.cli.tune import tune
from tarc.cli.verify import verify
from tarc.core.errors import TarcError
from tarc.core.version import __version__

app = typer.Typer(
    name="tarc",
    help="Robot tracking from position measurements alone: time-delayed adaptive robust control.\n\n"
    "Start with [bold]tarc demo[/bold], look around with [bold]tarc show[/bold], then write a scenario of your own "
    "and [bold]tarc run[/bold] it.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=False,
)

COMMANDS = (
    run,
    demo,
    certify,
    verify,
    design,
    compare,
    tune,
    study,
    studio,
    replay,
    identify,
    diagnose,
    show,
    export,
)
for command in COMMANDS:
    app.command()(command)
app.command(name="verify-export")(verify_export)
app.command(name="run-live")(run_live)
app.add_typer(ros2, name="ros2")


@app.callback(invoke_without_command=True)
def version(show_version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Handle options before any command."""
    if show_version:
        print(__version__)
        raise typer.Exit


def _warn(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    """Print a warning on one line."""
    print(f"warning: {message}", file=sys.stderr)


def main() -> None:
    """Run the command line; an error of the input is printed on one line, with exit status 2."""
    # matrices here are small, and threads on small matrices wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("MUJOCO_GL", "disable")  # no command draws with it, and its library takes a while to find
    warnings.showwarning = _warn
    try:
        app()
    except TarcError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        raise SystemExit(130) from None
