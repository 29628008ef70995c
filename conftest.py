"""Settings of all tests. Code blocks of README and docs are tests: one namespace a page, in a folder of its own."""

import os
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from sybil import Sybil
from sybil.parsers.markdown import PythonCodeBlockParser

settings.register_profile("tarc", deadline=None)  # an example takes as long as the machine is busy
settings.load_profile("tarc")

SLOW_PAGES = (
    "docs/explanation/claims.md",
    "docs/explanation/how-sure.md",
    "docs/explanation/optimum.md",
    "docs/start/your-robot.md",
)
"""Pages whose code takes longer than eight seconds."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the code of slow pages."""
    for item in items:
        if item.nodeid.startswith(SLOW_PAGES):
            item.add_marker(pytest.mark.slow)


def _enter(namespace: dict[str, Any]) -> None:
    namespace["_home"] = Path.cwd()
    namespace["_folder"] = tempfile.TemporaryDirectory()
    os.chdir(namespace["_folder"].name)


def _leave(namespace: dict[str, Any]) -> None:
    os.chdir(namespace["_home"])
    namespace["_folder"].cleanup()


pytest_collect_file = Sybil(
    parsers=[PythonCodeBlockParser()],
    patterns=["README.md", "docs/*.md", "docs/*/*.md"],
    setup=_enter,
    teardown=_leave,
).pytest()
