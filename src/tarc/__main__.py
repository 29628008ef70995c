"""Run the command line as ``python -m tarc``."""

from tarc.cli import main

main()
