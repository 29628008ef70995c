"""The command line."""

import gc
import sys

from tarc.core.errors import MissingTool
from tarc.core.optional import require

OBJECTS_BETWEEN_COLLECTIONS = 200_000
"""New objects after which Python looks for cycles of them; the default takes a tenth of a command's time."""


def main() -> None:
    """Run the command ``tarc``, or say which extra it needs."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    try:
        require("cli", "the command tarc")
    except MissingTool as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    from tarc.cli.main import main as run_command

    run_command()
