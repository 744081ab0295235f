"""The report: plots of every kind of trace, and a page that needs nothing else and hides nothing."""

from __future__ import annotations

import base64
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf import metrics
from bms_ukf.errors import ConfigError
from bms_ukf.records import NAN, Estimate, Sample, Status
from bms_ukf.report import plots
from bms_ukf.report.html import write_report
from bms_ukf.trace import Trace

PNG = b"\x89PNG\r\n\x1a\n"
ALL = ["soc", "soc_error", "voltage", "innovation", "nis", "profile"]
RUN = {"scenario": "a <b> & c", "cell": "lgm50_chen2020", "seed": 7, "duration_s": 5000.0}


def run(rows: int = 5000, *, reference: bool = True, voltage: bool = True, available: bool = True) -> Trace:
    """A made-up discharge with a 20 % error that decays, noise in the voltage and a missing row at the start."""
    rng = np.random.default_rng(1)
    trace = Trace(rows)
    for k in range(rows):
        t_ns, soc, current_A = k * 10**9, 0.9 - 0.6 * k / max(rows, 2), 2 + 3 * np.sin(k / 40)
        innovation_V = rng.normal(0, 0.003) + 0.1 * np.exp(-k / 30) if voltage else NAN
        measured = Sample(t_ns, current_A, 3.2 + soc if voltage else NAN, 25.0)
        estimate = Estimate(
            t_ns,
            soc - 0.2 * np.exp(-k / 50),
            0.01,
            3.2 + soc - innovation_V,
            innovation_V,
            9e-6,
            innovation_V**2 / 9e-6,
            status=Status.OK,
        )
        estimate.soc_low, estimate.soc_high = estimate.soc - 0.0196, estimate.soc + 0.0196
        missing = k == 0 or not available
        truth = Sample(t_ns, current_A, 3.2 + soc, 25.0)
        trace.append(measured, Estimate(t_ns) if missing else estimate, soc if reference else NAN, truth)
    return trace


def summary(trace: Trace) -> dict:
    return RUN | metrics.score(trace.t_s, trace["soc"], trace.interval, trace["soc_ref"])


class Page(HTMLParser):
    """Text, tags and attributes; refuses a tag that is not closed in order."""

    VOID = frozenset({"meta", "img"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text, self.tags, self.open = "", [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text = " ".join(f"{self.text} {data}".split())


@pytest.fixture(scope="module")
def trace() -> Trace:
    return run()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, trace: Trace) -> Path:
    path = tmp_path_factory.mktemp("report") / "made" / "by it"
    assert write_report(path, trace, summary(trace), title="a <b> & c") == path / "report.html"
    return path


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def test_the_folder_holds_the_page_and_every_plot(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(["report.html", *(f"{name}.png" for name in ALL)])
    assert all((folder / f"{name}.png").read_bytes().startswith(PNG) for name in ALL)


def test_the_page_carries_its_plots_and_refers_to_nothing_outside(folder: Path, page: Page) -> None:
    images = [attrs["src"] for tag, attrs in page.tags if tag == "img"]
    for name, source in zip(ALL, images, strict=True):
        kind, _, data = source.partition(",")
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data) == (folder / f"{name}.png").read_bytes()
    text = re.sub(r"data:image/png;base64,[^\"]+", "", (folder / "report.html").read_text(encoding="utf-8"))
    assert not re.search(r"https?:|url\(|@import|<script|<link", text)


def test_the_page_states_verdict_figures_and_origin(page: Page) -> None:
    for piece in (
        "SoC RMSE after 600 s: at most 1 %", "pass", "whole run", "after 600 s", "Largest absolute error",
        "lgm50_chen2020", "Sensor seed 7", "5000 s", "numpy", "Python",
    ):  # fmt: skip
        assert piece in page.text, piece
    assert "Rows without an estimate 1 0" in page.text


def test_what_a_user_wrote_is_escaped(page: Page) -> None:
    assert "a <b> & c" in page.text
    assert "b" not in {tag for tag, _ in page.tags}


def test_a_failed_goal_is_said_loudly(tmp_path: Path, trace: Trace) -> None:
    bad = summary(trace)
    bad["after_600s"]["rmse_pct"] = 1.5
    path = write_report(tmp_path / "bad.html", Trace(0), bad, title="bad")
    assert "1.50 % FAIL" in Page(path.read_text(encoding="utf-8")).text


def test_a_target_named_html_is_the_page_alone(tmp_path: Path) -> None:
    target, trace = tmp_path / "one.html", run(50)
    assert write_report(target, trace, summary(trace), title="one") == target
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize(
    ("options", "drawn"),
    [
        ({"reference": False}, ["soc", "voltage", "innovation", "nis", "profile"]),
        ({"voltage": False}, ["soc", "soc_error", "profile"]),
        ({"available": False}, ["profile"]),
        ({"rows": 2}, ALL),
        ({"rows": 0}, []),
    ],
)
def test_a_plot_without_data_is_left_out_and_the_rest_is_drawn(tmp_path: Path, options: dict, drawn: list[str]) -> None:
    trace = run(**{"rows": 50} | options)
    path = write_report(tmp_path, trace, summary(trace), title="part")
    assert sorted(file.stem for file in tmp_path.glob("*.png")) == sorted(drawn)
    text = Page(path.read_text(encoding="utf-8")).text
    assert ("nothing is scored" in text) == ("reference" in options or "available" in options or trace.t_ns.size == 0)


def test_a_place_that_cannot_be_written_is_named_in_one_line(tmp_path: Path, trace: Trace) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ConfigError) as caught:
        write_report(tmp_path / "file" / "report", Trace(0), summary(trace), title="no")
    assert caught.value.source == str(tmp_path / "file" / "report")


@given(values=st.lists(st.floats(-10, 10) | st.just(NAN), min_size=1, max_size=300), buckets=st.integers(1, 40))
def test_downsampling_keeps_every_extreme(values: list[float], buckets: int) -> None:
    y = np.array(values)
    t, shown = plots.envelope(np.arange(y.size, dtype=float), y, buckets)
    assert t.size == shown.size <= max(2 * buckets, 1)
    assert np.all(np.diff(t) >= 0)
    if np.isfinite(y).any():
        assert np.nanmin(shown) == np.nanmin(y)
        assert np.nanmax(shown) == np.nanmax(y)
    else:
        assert np.isnan(shown).all()


def test_the_same_trace_gives_the_same_pictures_and_matplotlibs_settings_stay(trace: Trace, folder: Path) -> None:
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    for plot, png in plots.render(trace):
        assert png == (folder / f"{plot.name}.png").read_bytes(), plot.name
    assert dict(mpl.rcParams) == before


def test_neither_matplotlib_nor_rich_is_imported_before_it_is_needed() -> None:
    code = (
        "import sys, bms_ukf.report.html, bms_ukf.simulate; sys.exit(bool({'matplotlib', 'rich'} & set(sys.modules)))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
