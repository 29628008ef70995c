"""Run the command line as ``python -m tarc``."""

from tarc.cli.app import main

main()
