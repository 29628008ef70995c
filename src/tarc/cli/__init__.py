"""The command line."""

from tarc.cli.app import main

__all__ = ["main"]
