"""The command `tarc` in the tests' own process, which has its modules already; a process of its own takes a second."""

import io
import os
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from subprocess import CompletedProcess
from unittest import mock

import pytest

from tarc.cli.main import main


def run_tarc(*arguments: str, cwd: Path, status: int = 0) -> "CompletedProcess[str]":
    """Run the command in a folder, and compare its exit status; return it with what it printed."""
    printed, errors = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, mock.patch.dict(os.environ, {"COLUMNS": "80"}):
        patch.chdir(cwd)
        patch.setattr("sys.argv", ["tarc", *arguments])
        with warnings.catch_warnings(), redirect_stdout(printed), redirect_stderr(errors):
            warnings.simplefilter("default")  # printed, as where no test makes them errors
            with pytest.raises(SystemExit) as stop:
                main()
    code = stop.value.code or 0
    assert code == status, errors.getvalue()
    return CompletedProcess(arguments, int(code), printed.getvalue(), errors.getvalue())
