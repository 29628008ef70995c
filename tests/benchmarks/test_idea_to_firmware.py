"""The page "From an idea to firmware", typed as a reader types it."""

import os
import re
import shutil

import pytest
from benchmarks.page_values.registry import type_page

from tarc.export.verification import read_law_yaml

PAGE = "start/idea-to-firmware.md"
CROSS = ("make", "arm-none-eabi-gcc", "qemu-system-arm")


@pytest.mark.slow
def test_a_law_of_ones_own_goes_from_an_equation_to_a_microcontroller(tmp_path):
    has_tools = all(shutil.which(tool) for tool in CROSS)
    assert has_tools or not os.environ.get("TARC_REQUIRE_CROSS"), f"needs {', '.join(CROSS)}"
    printed = list(type_page(PAGE, tmp_path, skip=() if has_tools else ("make",)).values())
    run, plain, certified, refused, tuned, compared, exported, verified, *firmware = printed
    assert "LeakyIntegral" in run
    assert "TDC" in plain
    assert re.search(r"this robot, in all +│ certified", certified)
    assert re.search(r"this robot, in all +│ refuted", refused)
    assert "written: gains.yaml" in tuned
    assert "LeakyIntegral" in compared
    assert "src/arm.c" in exported
    assert verified.endswith("the C is the law")
    law = read_law_yaml(tmp_path / "build" / "arm")
    assert law["scenario"]["content"]["law"]["kind"] == "../../leaky.py:LeakyIntegral"
    assert '"certified"' in (tmp_path / "build" / "arm" / "law.yaml").read_text(encoding="utf-8")
    assert all("0 of 2000 numbers differ" in text for text in firmware)
