"""`tarc export ros2`, `tarc run` with bags, and `tarc ros2`: what they write, and what they refuse."""

import json

import pytest
from typer.testing import CliRunner

from tarc.cli.main import app
from tarc.signals import read_log


def run(*words, status=0):
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == status, result.output
    return result


def test_a_package_is_written(tmp_path):
    folder = tmp_path / "arm_controller"
    printed = run("export", "ros2", "two_link_payload", "-o", folder, "--name", "arm").output
    assert "config/arm.yaml" in printed
    assert "natural_frequency" in (folder / "law.yaml").read_text()
    assert "no other" in (folder / "src" / "controller.cpp").read_text()


def test_what_a_package_cannot_have_is_refused(tmp_path):
    scenario = ["export", "ros2", "two_link_payload", "-o", tmp_path / "arm"]
    period = ["--set", "period=0.003", "--set", "estimator.window=0.03"]
    assert "update_rate of ros2_control is an integer" in str(run(*scenario, *period, status=1).exception)
    assert "only with the format c" in str(run(*scenario, "--firmware", status=1).exception)


@pytest.mark.slow
def test_a_run_is_a_bag_and_follows_one(tmp_path):
    bag, again = tmp_path / "run.mcap", tmp_path / "again.mcap"
    setting = ["--set", "duration=0.1", "--json"]
    first = json.loads(run("run", "two_link_payload", *setting, "-o", bag).output)
    assert len(first["files"]) == len(first["runs"])
    file = bag if bag.exists() else next(tmp_path.glob("run-*.mcap"))
    assert not list(tmp_path.glob("*.nc"))
    second = json.loads(run("run", "two_link_payload", "--reference", file, "-o", again, "--json").output)
    assert second["runs"].keys() == first["runs"].keys()
    log = read_log(next(tmp_path.glob("again*.mcap")))
    assert len(log.times) == 99
    missing = run("run", "two_link_payload", "--reference", tmp_path / "none.mcap", status=1)
    assert "no bag" in str(missing.exception)


@pytest.mark.slow
def test_a_node_without_a_robot_says_so(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "231")
    result = run("ros2", "run", "two_link_payload", "--timeout", 0.3, "--priority", 0, status=1)
    assert "nothing at all" in str(result.exception)
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    assert "ROS_DOMAIN_ID" in str(run("ros2", "run", "two_link_payload", "--priority", 0, status=1).exception)
