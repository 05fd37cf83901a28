"""The picture shows the evaluations where they belong."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from iher_robot.errors import UserError
from iher_robot.evaluation import plot as plot_module
from iher_robot.evaluation.plot import plot_success, success_points

FIRST, SECOND = "#0072B2", "#D55E00"


def draw(path: Path, *rates: float, **options: Any) -> NDArray[np.floating]:
    runs = {
        f"run {rate}": [{"robot_minutes": m, "success": rate} for m in (1, 5, 10)] for rate in rates
    }
    plot_success(runs, path, "Push", "iher", **options)
    return np.asarray(matplotlib.image.imread(path))[..., :3]


def places(image: NDArray[np.floating], color: str) -> NDArray[np.intp]:
    """Rows and columns of the pixels of a colour. ``(pixels, 2)``"""
    return np.argwhere(np.abs(image - np.array(to_rgb(color))).max(axis=-1) < 0.02)


def test_higher_success_is_drawn_higher(tmp_path: Path) -> None:
    image = draw(tmp_path / "plot.png", 0.2, 0.8)
    low, high = places(image, FIRST), places(image, SECOND)
    # Left of the legend.
    low, high = (pixels[pixels[:, 1] < image.shape[1] / 2] for pixels in (low, high))
    assert high[:, 0].max() < low[:, 0].min()


@pytest.mark.parametrize("log_x", [False, True])
def test_the_budget_widens_the_axis(tmp_path: Path, log_x: bool) -> None:
    alone = places(draw(tmp_path / "a.png", 0.5, log_x=log_x), FIRST)
    within = places(draw(tmp_path / "b.png", 0.5, log_x=log_x, budget_minutes=40), FIRST)
    assert within[:, 1].max() < 0.9 * alone[:, 1].max()


def test_only_evaluations_are_points() -> None:
    rows: list[dict[str, float | None]] = [
        {"robot_minutes": 2.0, "success": 0.5},
        {"robot_minutes": 1.0, "success": 0.25},
        {"robot_minutes": 3.0},
        {"robot_minutes": 4.0, "success": None},
        {"robot_minutes": 0.0, "success": 0.0},
    ]
    assert success_points(rows) == [(0.0, 0.0), (1.0, 0.25), (2.0, 0.5)]
    assert success_points(rows, log_x=True) == [(1.0, 0.25), (2.0, 0.5)]


@pytest.mark.parametrize("log_x", [False, True])
def test_a_run_without_evaluation_has_no_curve(tmp_path: Path, log_x: bool) -> None:
    path = tmp_path / "plot.png"
    plot_success({"run": [{"robot_minutes": 1.0}]}, path, "$1_{ of 2$", "x^", log_x=log_x)
    assert len(places(np.asarray(matplotlib.image.imread(path))[..., :3], FIRST)) == 0


def test_a_picture_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"cannot write .*absent/plot\.png"):
        plot_success({}, tmp_path / "absent" / "plot.png", "Push")


@pytest.mark.parametrize("minutes", [0.03, 0.1, 2.0, 60.0])
def test_the_labels_of_the_origin_do_not_touch(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, minutes: float
) -> None:
    canvases: list[FigureCanvasAgg] = []
    monkeypatch.setattr(
        plot_module,
        "write_atomically",
        lambda path, write: canvases.append(write.__self__),
    )
    rows = [{"robot_minutes": minutes, "success": 0.5}]
    plot_success({"run": rows}, tmp_path / "plot.png", "Reach", budget_minutes=minutes)
    (canvas,) = canvases
    canvas.draw()
    (axes,) = canvas.figure.axes
    x_label, y_label = (axis.get_ticklabels()[0] for axis in (axes.xaxis, axes.yaxis))
    assert (x_label.get_text(), y_label.get_text()) == ("0", "0%")
    first, second = (label.get_window_extent() for label in (x_label, y_label))
    assert not first.padded(2).overlaps(second)


def test_plotting_leaves_the_users_figures_alone() -> None:
    code = "import sys, iher_robot.evaluation.plot; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
