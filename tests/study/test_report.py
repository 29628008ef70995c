"""The report of a study, from made-up results of the layout that studies have."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
import xarray as xr

from tarc.core.errors import InvalidParameter
from tarc.study.report import write_report
from tarc.study.summary import summarise

STUDY = """name: made_up
scenario: two_link_payload
runs: 1000
draws:
  robot.payload: {uniform: [0.0, 3.0]}
  sensor.noise: {log_uniform: [1.0e-6, 1.0e-4]}
  sensor.bits: {choice: [14, 16, 18]}
"""


def made_up(runs=300, laws=("TDC", "TARC", "PID"), diverged=0.05, seed=1):
    """Errors that grow with payload and noise; the second law has nine tenths, the third ten times as much."""
    rng = np.random.default_rng(seed)
    payload, noise = 3 * rng.random(runs), 10 ** (-6 + 2 * rng.random(runs))
    bits = rng.choice([14, 16, 18], runs)
    base = 2e-4 * (1 + payload) * (1 + 0.2 * np.log10(noise / 1e-6)) * rng.lognormal(0, 0.05, runs)
    scale = np.array([1.0, 0.9, 10.0, 1.0, 2.0])[: len(laws)]
    error = base[:, None] * scale * rng.lognormal(0, 0.05, (runs, len(laws)))
    completed = rng.random((runs, len(laws))) > diverged * (payload[:, None] > 2)
    table = ("run", "law")

    def measured(values):
        return table, np.where(completed, values, np.nan)

    return xr.Dataset(
        {
            "rms_error": measured(error),
            "peak_error": measured(4 * error),
            "torque_variation": measured(400 + 1e6 * error),
            "saturated": measured(0 * error),
            "completed": (table, completed),
            "end_time": (table, np.where(completed, 12.0, 7.3)),
            "drawn:robot.payload": ("run", payload),
            "drawn:sensor.noise": ("run", noise),
            "drawn:sensor.bits": ("run", bits),
        },
        {"run": np.arange(runs), "law": list(laws)},
        {
            "title": "study made_up",
            "study": STUDY,
            "source": "tarc-control 0.1.0",
            "integration": {"integrator": "midpoint", "substeps": 1},
            "joint_units": ["rad", "rad"],
            "command_unit": "",
        },
    )


class Balanced(HTMLParser):
    """Counts what is open; void elements close themselves."""

    def __init__(self):
        super().__init__()
        self.open, self.ids = [], []

    def handle_starttag(self, tag, attrs):
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in ("meta", "br", "use", "path", "image", "rect"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.ids += [value for name, value in attrs if name == "id"]

    def handle_endtag(self, tag):
        if tag in ("path", "use", "image", "rect"):
            return
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def text(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    return write_report(made_up(), path).read_text(encoding="utf-8")


def test_report_is_one_file_that_needs_no_network(text):
    without_namespaces = re.sub(r"http://www\.w3\.org/[\w/]+", "", text)
    assert "http" not in without_namespaces.replace("Tarc", "")
    assert "<script" not in text
    assert not re.search(r'(src|href)="(?!#|data:)', text)


def test_report_is_well_formed(text):
    parser = Balanced()
    parser.feed(text)
    assert parser.open == []
    assert len(parser.ids) == len(set(parser.ids))


def test_report_says_what_was_varied_and_found(text):
    for part in (
        "uniform, 0 to 3",
        "log-uniform, 1e-06 to 0.0001",
        "one of 14, 16, 18",
        "300 runs of 3 laws with 3 draws each",
        "What the intervals mean",
        "tarc study study.yaml",
        "midpoint, steps per period: 1",
        "var(--c0)",
        "currentColor",
    ):
        assert part in text, part
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL).lower()


def test_summary_finds_what_was_put_in():
    summary = summarise(made_up())
    less, more = summary.comparisons["rms_error"]
    assert (less.law, less.verdict) == ("TARC", "less")
    assert less.ratio.low < 0.9 < less.ratio.high
    assert (more.law, more.verdict) == ("PID", "more")
    assert more.ratio.low < 10 < more.ratio.high
    found = summary.sensitivities["rms_error"]["TDC"]
    assert found.order[0] == "robot.payload"
    assert found.first_order["sensor.bits"].low == 0
    assert summary.success["TDC"].estimate == summary.completed[:, 0].mean()


def test_measures_of_diverged_runs_do_not_count():
    """Some stores have the measures up to the divergence: they are smaller than they would have been."""
    data = made_up()
    data["rms_error"] = data["rms_error"].fillna(1e-9)
    summary = summarise(data)
    assert np.isnan(summary.values["rms_error"][~summary.completed]).all()


def test_limits_are_part_of_success():
    data = made_up(diverged=0.0)
    assert summarise(data).success["PID"].estimate == 1
    limited = summarise(data, limits={"rms_error": 1e-3})
    assert limited.success["PID"].estimate == np.mean(data["rms_error"].sel(law="PID") <= 1e-3)
    with pytest.raises(InvalidParameter, match="rms_error"):
        summarise(data, limits={"rms_eror": 1e-3})


def test_one_law_and_no_draws(tmp_path):
    data = made_up(runs=20, laws=("TDC",))
    data = data.drop_vars([name for name in data if str(name).startswith("drawn:")])
    data.attrs.clear()
    text = write_report(data, tmp_path / "one.html").read_text(encoding="utf-8")
    assert "Nothing but the noise" in text
    assert "Against" not in text


@pytest.mark.slow
def test_law_that_always_diverges(tmp_path):
    data = made_up(runs=100)
    completed = data["completed"].values.copy()
    completed[:, 2] = False
    data["completed"] = (("run", "law"), completed)
    text = write_report(data, tmp_path / "lost.html").read_text(encoding="utf-8")
    assert "100 runs diverged, the first 10" in text


@pytest.mark.slow
def test_names_are_escaped(tmp_path):
    data = made_up(runs=50, laws=("<b>TDC", "TARC & co"))
    text = write_report(data, tmp_path / "odd.html").read_text(encoding="utf-8")
    assert "<b><b>TDC" not in text
    assert "TARC &amp; co" in text


def test_folder_must_exist(tmp_path):
    with pytest.raises(InvalidParameter, match="does not exist"):
        write_report(made_up(runs=20), tmp_path / "nowhere" / "report.html")


@pytest.mark.slow
def test_ten_thousand_runs_fit_into_a_small_file(tmp_path):
    path = write_report(made_up(runs=10_000, laws=("TDC", "TARC")), tmp_path / "report.html")
    assert path.stat().st_size < 2e6
