"""A law from a user's own file as C: the file is named from the export, and a changed class shows."""

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tarc.cli.export import stored_certificate
from tarc.cli.main import app
from tarc.export.verification import read_law_yaml
from tarc.scenario.loader import SHIPPED

LAW = """
from dataclasses import dataclass
import tarc

@dataclass(frozen=True, kw_only=True, eq=False)
class Push(tarc.laws.TDE):
    push: float = 2.0
    robust_slope_bound = 0.0
    def robust_init(self):
        return ()
    def robust(self, state, tracking):
        return state, -self.push * tracking.error, {}
"""


def tarc_command(*words, status=0):
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == status, result.output
    return result.output


def test_a_law_of_a_file_is_exported_and_verified_from_anywhere(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(LAW)
    monkeypatch.chdir(tmp_path)
    tarc_command("export", "c", "two_link_payload", "--law", "mine.py:Push", "--set", "law.push=3", "-o", "build/arm")
    scenario = read_law_yaml("build/arm")["scenario"]
    assert scenario["content"]["law"]["kind"] == "../../mine.py:Push"
    assert scenario["content"]["law"]["push"] == 3
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert "the C is the law" in tarc_command("verify-export", "../build/arm", "--steps", 500)
    (tmp_path / "mine.py").write_text(LAW.replace("-self.push", "-2 * self.push"))
    assert "the C is NOT shown to be the law" in tarc_command("verify-export", "../build/arm", "--steps", 500, status=1)


@pytest.mark.parametrize("law", ["mine.py:Nothing", "other.py:Push"])
def test_a_law_that_is_not_there_is_refused(law, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(LAW)
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["export", "c", "two_link_payload", "--law", law]).exit_code != 0
    assert not (tmp_path / "build").exists()


def test_a_certificate_that_is_older_than_the_law_is_not_taken(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(LAW)
    scenario = tmp_path / "arm.yaml"
    scenario.write_text((SHIPPED / "two_link_payload.yaml").read_text().replace("kind: TDC", "kind: mine.Push"))
    certificate = tmp_path / "runs" / "arm" / "Push-certificates.json"
    certificate.parent.mkdir(parents=True)
    content = {"verdict": "certified", "margin": 0.1, "claim": "it is stable", "assumptions": []}
    certificate.write_text(json.dumps({"robot": content}))
    monkeypatch.chdir(tmp_path)
    now = certificate.stat().st_mtime
    for changed, is_taken in ((None, True), (scenario, False), (tmp_path / "mine.py", False)):
        for file in (scenario, tmp_path / "mine.py"):
            os.utime(file, (now - 5, now - 5))
        if changed is not None:
            os.utime(changed, (now + 5, now + 5))
        assert (stored_certificate(Path("arm.yaml"), "Push") is not None) is is_taken
