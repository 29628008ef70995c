"""The command line."""

import sys

from tarc.core.errors import MissingTool
from tarc.core.optional import require


def main() -> None:
    """Run the command ``tarc``, or say which extra it needs."""
    try:
        require("cli", "the command tarc")
    except MissingTool as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    from tarc.cli.main import main as run_command

    run_command()
