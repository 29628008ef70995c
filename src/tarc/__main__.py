"""Run the command line as ``python -m tarc``."""

from tarc.cli import main

if __name__ == "__main__":  # processes that the page starts import this module
    main()
