"""Proofs that go on: time that ended, Ctrl-C, files of other questions, and broken files."""

import numpy as np
import pytest

from tarc.analysis import Workspace, prove_inertia_spread, stored_proof
from tarc.core.progress import Progress
from tarc.plants import NLinkArm, TwoLinkArm
from tarc.plants.base import Plant

ARM = NLinkArm()
WORKSPACE = Workspace.box(np.full(3, -2.0), np.full(3, 2.5))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(stored_proof, "proofs_folder", lambda: tmp_path / "proofs")
    monkeypatch.setattr(stored_proof, "MIN_SAVED_TIME", 0.0)
    return tmp_path / "proofs"


def prove(arm: Plant = ARM, workspace=WORKSPACE, tolerance=0.02, **options):
    nominal = np.diag(np.arange(arm.n_joints, 0, -1.0))
    return prove_inertia_spread(arm, nominal, workspace, tolerance=tolerance, samples=200, progress=False, **options)


def files(folder):
    return sorted(path.name for path in folder.glob("*"))


def test_a_proof_goes_on_where_time_ended(folder):
    whole = prove()
    assert whole.complete
    for file in folder.glob("*"):
        file.unlink()
    assert prove(time_limit=1e-9).share == 0
    shares = [prove(time_limit=1e-3).share for _ in range(2)]
    assert shares == sorted(shares)
    ended = prove()
    assert ended.complete
    assert ended.n_boxes == whole.n_boxes
    assert len(files(folder)) == 1


def test_a_proof_that_ended_is_found_at_once(folder):
    whole = prove()
    again = prove(time_limit=1e-9)
    assert again.complete
    assert again.n_boxes == whole.n_boxes
    assert again.max_ratio == whole.max_ratio


def test_another_question_is_proven_anew(folder):
    prove()
    others = [
        {"arm": NLinkArm(payload=1e-6)},
        {"tolerance": 0.021},
        {"workspace": Workspace.box(np.full(3, -2.0), [2.5, 2.5, 2.4999])},
    ]
    for number, other in enumerate(others, 2):
        assert not prove(**other, time_limit=1e-9).complete
        assert len(files(folder)) == number


def test_ctrl_c_keeps_what_is_proven(folder, monkeypatch):
    calls = []

    def interrupt(self, steps=1):
        calls.append(steps)
        if len(calls) == 3:
            raise KeyboardInterrupt

    whole = prove(TwoLinkArm(), Workspace.box([-2.0, -2.0], [2.0, 2.0]))
    for file in folder.glob("*"):
        file.unlink()
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "advance", interrupt)
        with pytest.raises(KeyboardInterrupt):
            prove(TwoLinkArm(), Workspace.box([-2.0, -2.0], [2.0, 2.0]))
    assert len(files(folder)) == 1
    kept = prove(TwoLinkArm(), Workspace.box([-2.0, -2.0], [2.0, 2.0]), time_limit=1e-9)
    assert 0 < kept.share < 1
    ended = prove(TwoLinkArm(), Workspace.box([-2.0, -2.0], [2.0, 2.0]))
    assert ended.complete
    assert ended.n_boxes == whole.n_boxes


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut off", b"nothing"])
def test_a_broken_file_begins_anew(folder, content):
    prove(time_limit=1e-9)
    (file,) = folder.glob("*")
    file.write_bytes(content)
    assert prove().complete
