"""``tarc design``, from a robot's file to a scenario that runs and certifies again."""

import importlib
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from rich.cells import cell_len
from typer.testing import CliRunner

import tarc.design
from slow_cases import slow
from tarc import TarcError, plants
from tarc.cli.main import app
from tarc.design import Design, DesignChoice, StressLimit, design_controller
from tarc.scenario.model import Scenario
from tarc.scenario.yaml_text import read_yaml
from tarc.stored_certificates import certificate_from_dict
from urdf_text import arm, joint, link

ENDLESS = '<limit effort="80" velocity="3"/>'
FINGER = joint("finger", "fore", "tip", inside='<limit lower="0" upper="1" effort="9"/><mimic joint="elbow"/>')
ROBOT = arm(
    shoulder=joint("shoulder", "base", "upper", "continuous", ENDLESS),
    elbow=joint("elbow", "upper", "fore", inside='<limit lower="-2" upper="2" effort="40" velocity="3"/>'),
    more=link("tip", 0.1) + FINGER,
)
QUICK = ["--speed", "inf", "--law", "tdc", "--no-figures"]
"""Without the search for a bounded speed and for the switching gain, where a test is about neither."""
ASKED = ["--payload", "0", "1", "--armature", "0.1", "--samples", "60", "--encoder-bits", "19"]


@pytest.fixture(scope="module", autouse=True)
def few_candidates():
    """Few loops to choose from, so that a design takes a second."""
    with pytest.MonkeyPatch.context() as patch:
        front = importlib.import_module("tarc.design.candidates")
        patch.setattr(front, "WINDOWS", (4, 8))
        patch.setattr(front, "NATURAL_FREQUENCIES", (4.0, 8.0, 14.0))
        patch.setattr(importlib.import_module("tarc.design.assessment"), "CENTRES", np.geomspace(0.02, 1.2, 12))
        yield


def invoke_tarc(*arguments, folder, status=0):
    """Return the command, run in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("sys.argv", ["tarc", *arguments])
        patch.setenv("COLUMNS", "80")
        done = CliRunner().invoke(app, list(arguments))
    if status == 0:
        assert done.exit_code == 0, (done.output, done.exception)
    return done


@pytest.fixture(scope="module")
def designed_folder(tmp_path_factory):
    """Return the folder in which a robot was designed for, and what was printed."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(ROBOT)
    done = invoke_tarc("design", "arm.urdf", *ASKED, "-o", "out.yaml", folder=folder)
    return folder, done.stdout


@pytest.fixture(scope="module")
def designed_in_python():
    """Return a design in Python, of a robot without a file."""
    robot = plants.TwoLinkArm(viscous=0.5)
    return design_controller(
        robot, law="TDC", payload=(0.0, 0.5), torque_limits=[100.0, 50.0], diagonal=True, samples=60
    )


def comments_by_key(text):
    """By path, such as law.inertia, the comment above the key."""
    found, above, section = {}, [], ""
    for line in text.splitlines():
        if line.strip().startswith("#"):
            above.append(line.strip()[1:].strip())
        elif match := re.match(r"( *)(\w+):", line):
            section = section if match[1] else match[2]
            found[f"{section}.{match[2]}" if match[1] else section] = " ".join(above)
            above = []
        else:
            above = []
    return found


def test_what_is_written_is_what_is_said(designed_folder):
    folder, printed = designed_folder
    names = ["out.yaml", "out-certificates.json", "out-front.png", "out-reach.png", "out-optimum.png", "out-law.png"]
    assert printed.splitlines()[-1] == "written: " + ", ".join(names)
    assert {file.name for file in folder.iterdir()} == {"arm.urdf", *names}
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in names if name.endswith("png"))


def test_a_trajectory_gives_postures_and_speeds(tmp_path):
    (tmp_path / "arm.urdf").write_text(ROBOT)
    times = np.linspace(0, 4, 201)
    motion = np.column_stack([times, 0.4 * np.sin(times) ** 2, 0.3 + 0.2 * np.sin(2 * times) ** 2])
    np.savetxt(tmp_path / "motion.csv", motion, delimiter=",", header="time,shoulder,elbow", comments="")
    call = ["design", "arm.urdf", "--trajectory", "motion.csv", "--tube", "0.02", *ASKED, "--law", "tdc"]
    invoke_tarc(*call, "--no-figures", "-o", "out.yaml", folder=tmp_path)
    written = (tmp_path / "out.yaml").read_text()
    content = read_yaml(written, "out.yaml")
    assert content["reference"]["path"] == "motion.csv"
    assert content["duration"] == pytest.approx(4.0)
    assert re.search(r"tarc certify .* --tube 0.02 --speed 0.48", " ".join(written.replace("#", " ").split()))
    (run,) = Scenario.load(tmp_path / "out.yaml", ["duration=1.0", "metrics_start=0.5"]).run().values()
    assert run.status.completed


OWN_LAW = """
from dataclasses import dataclass
import tarc

@dataclass(frozen=True, kw_only=True, eq=False)
class Soft(tarc.laws.TDE):
    stiffness: float = 2.0
    @property
    def robust_slope_bound(self):
        return self.stiffness
    def robust_init(self):
        return ()
    def robust(self, state, tracking):
        return state, -self.stiffness * tracking.error, {}

@dataclass(frozen=True, kw_only=True, eq=False)
class Other(tarc.laws.PID):
    pass
"""


def test_a_law_of_ones_own_is_designed(tmp_path):
    (tmp_path / "arm.urdf").write_text(ROBOT)
    (tmp_path / "mine.py").write_text(OWN_LAW)
    call = ["design", "arm.urdf", *ASKED, "--speed", "inf", "--no-figures", "-o", "out.yaml", "--json"]
    summary = json.loads(invoke_tarc(*call, "--law", "mine.py:Soft", folder=tmp_path).stdout)
    assert read_yaml((tmp_path / "out.yaml").read_text(), "out")["law"]["kind"] == "mine.py:Soft"
    assert Scenario.load(tmp_path / "out.yaml").certify(samples=60, full_range=True)["Soft"].verdict.certified
    predicted, tried = summary["predicted_rms_error"], summary["trial"]["rms_error"]
    assert 0.5 < predicted / tried < 2
    refused = invoke_tarc(*call, "--law", "mine.py:Other", folder=tmp_path, status=2)
    assert "Other extends no time-delay estimation" in str(refused.exception)


def test_the_table_fits_a_terminal_and_tells_each_choice(designed_folder):
    _, printed = designed_folder
    assert max(cell_len(line.rstrip()) for line in printed.splitlines()[:-1]) <= 80
    first = {line.split("│")[1].strip() for line in printed.splitlines() if line.startswith("│")}
    assert {"robot", "payload", "weight", "inertia", "window", "natural frequency", "smallest gain"} <= first
    assert "certified: TARC keeps the robot stable" in printed
    assert re.search(r"margin 0\.\d+, radius over the one needed", printed)
    assert re.search(r"predicted torque noise, .*: shoulder [\d.]+ N m \([\d.]+ %\), elbow", printed.replace("\n", " "))
    assert re.search(r"step of the encoders: [\d.]+ mrad on every joint", printed)
    tried = re.search(
        r"tried in simulation: completed, RMS error [\d.e-]+ mrad, torque noise at most ([\d.]+) of",
        " ".join(printed.split()),
    )
    assert tried
    assert float(tried[1]) < 2


def test_the_scenario_runs_from_anywhere(designed_folder, tmp_path, monkeypatch):
    folder, _ = designed_folder
    moved = tmp_path / "moved"
    shutil.copytree(folder, moved)
    monkeypatch.chdir(tmp_path)
    for place in (folder, moved):
        scenario = Scenario.load(
            place / "out.yaml", ["duration=1.2", "metrics_start=0.4", "disturbance.0.start_time=0.6"]
        )
        assert scenario.robot["file"] == str(place / "arm.urdf")
    (run,) = scenario.run(progress=False).values()
    assert run.status.completed
    assert run.status.saturated == 0
    assert run.metrics(start_time=0.4)["rms_error"] < 0.02


def test_speed_is_that_of_the_file(designed_folder):
    folder, printed = designed_folder
    assert "speed" in printed
    proof = json.loads((folder / "out-certificates.json").read_text())["robot"]
    assert proof["evidence"]["max_rate_point"]["velocity_limits"] == [3.0, 3.0]


@pytest.mark.parametrize(("given", "said"), [("inf", "any"), slow("0.7,0.4", "0.7, 0.4 rad/s")])
def test_speed_is_as_asked(designed_folder, tmp_path, given, said):
    folder, _ = designed_folder
    options = [*ASKED, "--law", "tdc", "--speed", given, "--json", "--no-figures", "-o", str(tmp_path / "some.yaml")]
    found = json.loads(invoke_tarc("design", str(folder / "arm.urdf"), *options, folder=tmp_path).stdout)
    assert found["choices"]["speed"]["value"] == said
    sines = Scenario.load(tmp_path / "some.yaml").build_reference()
    _, velocity, _ = sines.sample(np.linspace(0, 10, 2000))
    if given != "inf":
        assert np.all(np.abs(velocity).max(axis=1) <= [0.7, 0.4])


def test_it_certifies_again_over_the_full_range(designed_folder, tmp_path):
    folder, _ = designed_folder
    path = str(folder / "out.yaml")
    (line,) = re.findall(r"tarc certify out.yaml (.*)", (folder / "out.yaml").read_text())
    options = line.split()
    assert options == ["--full-range", "--speed", "3"]
    done = invoke_tarc("certify", path, *options, "--samples", "150", "--json", "--no-figures", folder=tmp_path)
    again = json.loads(done.stdout)["certificates"]["TARC"]["robot"]
    before = certificate_from_dict(json.loads((folder / "out-certificates.json").read_text())["robot"])
    assert before.verify()
    assert before.verdict == again["verdict"] == "certified"
    assert again["findings"]["min_ratio"] == pytest.approx(before.evidence.min_ratio, rel=0.02)


def test_each_choice_stands_above_its_key(designed_folder):
    folder, _ = designed_folder
    text = (folder / "out.yaml").read_text()
    above, content = comments_by_key(text), read_yaml(text, "design")
    expected = {
        "robot.file": "robot: ",
        "reference": "workspace: ",
        "disturbance": "payload: ",
        "law.torque_limit": "weight: ",
        "law.inertia": "inertia: ",
        "estimator.window": "window: ",
        "law.natural_frequency": "natural frequency: ",
        "law.delay": "delay: ",
        "law.boundary_layer": "boundary layer, largest gain: ",
        "law.rise_rate": "rise and fall rates: ",
        "law.min_gain": "smallest gain: ",
        "sensor": "torque noise: ",
    }
    for key, label in expected.items():
        assert label in above[key], key
    assert "locked at home: finger (mimics elbow)" in above["robot.file"]
    assert "no range is known for shoulder, which is taken to ±π" in above["reference"]
    assert content["robot"] == {"file": "arm.urdf", "armature": 0.1, "payload": 0.0}
    assert content["law"]["damping_ratio"] == 1.0
    assert content["law"]["synchronised"] in (True, False)
    assert "delay" in content["law"]
    assert max(len(line) for line in text.splitlines() if line.lstrip().startswith("#")) <= 112


def test_on_top_is_how_it_was_made_and_the_verdict(designed_folder):
    folder, _ = designed_folder
    head = (folder / "out.yaml").read_text().split("\n\n")[0]
    assert head.startswith(f"# Made by: tarc design arm.urdf {' '.join(ASKED)} -o out.yaml\n")
    for part in (
        "# Verdict: certified; radius over the one needed",
        "# Certificates: out-certificates.json",
        "# Run it: tarc run out.yaml. Certify it again: tarc certify out.yaml --full-range",
    ):
        assert part in head


def test_json_and_a_part_of_the_workspace(designed_folder, tmp_path):
    folder, _ = designed_folder
    arguments = ["design", str(folder / "arm.urdf"), *ASKED, "--joint-range", "0.5", *QUICK, "--json"]
    found = json.loads(invoke_tarc(*arguments, folder=tmp_path).stdout)
    assert found["verdict"] == "certified"
    assert found["margin"] > 0
    assert found["law"]["kind"] == "TDC"
    assert found["choices"]["workspace"]["value"] == "a part of what the joints reach"
    assert set(found["torque_noise"]) == {"shoulder", "elbow"}
    assert found["trial"]["status"] == "completed"
    assert found["trial"]["saturation_share"] == 0
    assert found["files"] == ["design.yaml", "design-certificates.json"]
    content = read_yaml((tmp_path / "design.yaml").read_text(), "design.yaml")
    assert content["robot"]["file"] == str(folder / "arm.urdf")  # not in the folder of the scenario
    assert np.max(np.abs(content["reference"]["offset"]) + content["reference"]["amplitude"]) <= 0.5
    assert "tarc certify design.yaml --tube 0.01" in (tmp_path / "design.yaml").read_text()


def test_the_same_in_python(designed_in_python, tmp_path):
    files = designed_in_python.save(tmp_path / "two" / "links.yml")
    assert [file.name for file in files] == ["links.yml", "links-certificates.json"]
    text = designed_in_python.to_yaml()
    assert text.startswith("# Made by: tarc.design.design_controller\n")
    content = read_yaml(text, "design")
    assert content["robot"]["kind"] == "TwoLinkArm"
    assert content["robot"]["viscous"] == [0.5, 0.5]
    assert len(content["law"]["inertia"]) == 2  # a diagonal as such
    scenario = Scenario.load(files[0])
    plant, reference = scenario.build_plant(), scenario.build_reference()
    (law,) = scenario.build_laws(plant, reference).values()
    assert np.allclose(law.M, designed_in_python.law.M, rtol=1e-7)
    for name in ("natural_frequency", "damping_ratio", "synchronised", "delay_periods", "period"):
        assert getattr(law, name) == getattr(designed_in_python.law, name), name
    assert law.estimator.samples == designed_in_python.law.estimator.samples


def test_what_cannot_be_written_says_so(designed_in_python, tmp_path):
    (tmp_path / "taken").write_text("a file, not a folder")
    with pytest.raises(TarcError, match="save: cannot write .*taken/design.yaml: .*; free space or"):
        designed_in_python.save(tmp_path / "taken" / "design.yaml")
    assert designed_in_python.save(tmp_path)[0] == tmp_path / "design.yaml"


def test_choices_without_a_key_stand_on_top(designed_in_python):
    choice = DesignChoice((), "colour", "blue", "it goes with the arm")
    head = replace(designed_in_python, choices=(choice,)).to_yaml().split("\n\n")[0]
    assert "# colour: blue; it goes with the arm" in head


def test_the_front_shows_the_budget_and_plain_numbers(designed_in_python):
    (axes,) = designed_in_python.plot("front").axes
    labels = axes.get_legend_handles_labels()[1]
    assert "budget, 1 %" in labels
    assert "chosen" in labels
    (line,) = [one for one in axes.get_lines() if one.get_label() == "budget, 1 %"]
    assert line.get_xdata()[0] == pytest.approx(1.0)
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        texts = [axis.get_major_formatter()(tick) for tick in axis.get_majorticklocs() if low <= tick <= high]
        assert len(texts) >= 2
        assert all(re.fullmatch(r"[\d.]+(e[-+]\d+)?", text) for text in texts), texts
    assert axes.get_title() == "TwoLinkArm, 0 to 0.5 kg: TDC at 1000 Hz"
    star = next(one for one in axes.get_lines() if one.get_label() == "chosen")
    level = 100 * np.max(designed_in_python.torque_change / np.array([100.0, 50.0]))
    assert star.get_xdata()[0] == pytest.approx(level)


def test_the_map_has_a_panel_a_kind_and_one_bandwidth_gives_lines(designed_in_python):
    both = designed_in_python.plot("reach")
    assert [axes.get_title() for axes in both.axes[:2]] == [
        f"{word}, degree {designed_in_python.candidate.degree}" for word in ("literal", "synchronised")
    ]
    speed = designed_in_python.candidate.natural_frequency
    some = tuple(one for one in designed_in_python.candidates if one.natural_frequency == speed)
    given = replace(designed_in_python.requirements, natural_frequency=speed)
    fixed = replace(designed_in_python, candidates=some, requirements=given)
    (axes,) = fixed.plot("reach").axes
    assert f"{speed:.4g} rad/s" in axes.get_ylabel()
    labels = axes.get_legend_handles_labels()[1]
    assert "chosen" in labels
    assert f"the robot's spread, {designed_in_python.spread:.3g}" in labels
    (front,) = fixed.plot("front").axes
    assert not any("budget" in label for label in front.get_legend_handles_labels()[1])


def test_figures_of_a_single_joint(tmp_path):
    """Its spread is 1, so that no line of the map is the robot's."""
    made = design_controller(plants.Pendulum(), torque_limits=30.0, samples=20)
    assert isinstance(made, Design)
    for kind in ("front", "reach"):
        made.plot(kind).savefig(tmp_path / f"{kind}.png")
    assert "white line" not in made.plot("reach").get_suptitle()


@pytest.mark.slow
def test_limits_are_asked_for(designed_folder, monkeypatch):
    folder, _ = designed_folder
    answer = {"payload": StressLimit(name="payload", value=2.5, verdict="certified with a margin of 1 %")}
    monkeypatch.setattr(tarc.design, "stress_test", lambda _: answer)
    arguments = ["design", "arm.urdf", *ASKED, "--stress-test", *QUICK, "-o", "other.yaml"]
    assert "payload: 2.5 kg, certified" in invoke_tarc(*arguments, folder=folder).stdout
    found = json.loads(invoke_tarc(*arguments, "--json", folder=folder).stdout)["stress_limits"]["payload"]
    assert found["value"] == 2.5
    for name in ("other.yaml", "other-certificates.json"):
        (folder / name).unlink()


@pytest.mark.slow
def test_too_fast_for_the_rate_says_both_ways_out(designed_folder, tmp_path):
    """The natural frequency and the rate that the message names do, and a little more than either does not."""
    folder, _ = designed_folder
    arguments = ["design", str(folder / "arm.urdf"), *ASKED, *QUICK]
    message = str(
        invoke_tarc(
            *arguments, "--natural-frequency", "200", "--control-rate", "500", folder=tmp_path, status=1
        ).exception
    )
    assert message.startswith("design: nothing can be certified at 200 rad/s. ")
    found = re.search(r"a natural frequency of at most ([\d.]+) rad/s; a control rate of at least ([\d.]+) Hz", message)
    assert found, message
    natural_frequency, rate = float(found[1]), float(found[2])
    assert 2 < natural_frequency < 200
    # but for gravity, what a loop tolerates depends on the natural frequency times the period
    assert natural_frequency * rate == pytest.approx(200 * 500, rel=0.2)
    for within in (
        ["--natural-frequency", found[1], "--control-rate", "500"],
        ["--natural-frequency", "200", "--control-rate", found[2]],
    ):
        assert "certified" in invoke_tarc(*arguments, *within, "-o", "slower.yaml", folder=tmp_path).stdout
    assert not (tmp_path / "design.yaml").exists()


def test_a_bandwidth_and_a_budget_that_exclude_each_other(designed_folder, tmp_path):
    folder, _ = designed_folder
    arguments = [
        "design",
        str(folder / "arm.urdf"),
        *ASKED,
        *QUICK,
        "--natural-frequency",
        "8",
        "--noise-budget",
        "0.000001",
    ]
    message = str(invoke_tarc(*arguments, folder=tmp_path, status=1).exception)
    assert re.match(
        r"noise_budget: needed [-e\d.]+ % of the torque limit, the least of all certified loops at 8 rad/s; available "
        r"0.0001 %. Any one of these changes admits a design: a noise_budget of [-e\d.]+; an encoder of \d+ bits",
        message,
    )


def test_help_teaches(tmp_path):
    text = invoke_tarc("design", "--help", folder=tmp_path).stdout
    assert "Example: tarc design ur5e --payload 0 5 --armature 0.1 --speed 1" in text
    for option in (
        "--payload",
        "--encoder-bits",
        "--control-rate",
        "--joint-range",
        "--noise-budget",
        "--torque-limits",
        "--stress-test",
    ):
        assert option in text
    assert "LOW HIGH" in text
