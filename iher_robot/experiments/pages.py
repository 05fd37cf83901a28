"""The report of an experiment: Markdown, and the same as one HTML file."""

from __future__ import annotations

import base64
import csv
import importlib.metadata
import importlib.resources
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import markupsafe
from markdown_it import MarkdownIt

from iher_robot.durable_file import read_file, write_atomically
from iher_robot.experiments import words
from iher_robot.experiments.figures import draw_minutes, draw_success
from iher_robot.experiments.findings import (
    RATES,
    Method,
    baseline_of,
    find_methods,
    over_tasks,
    ratio_to_baseline,
)
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.numbers import LEAST_TRIMMED, REPETITIONS
from iher_robot.experiments.table import read_table

_WIDTH_OF_A_CPU = 60


def write_report(folder: ExperimentFolder, out: Path, made: str) -> tuple[Path, Path]:
    """Write report and figures, from the tables alone.

    Args:
        folder: The experiment.
        out: Folder to write to.
        made: When, in words.

    Returns:
        The Markdown and the HTML file.

    Raises:
        UserError: A table is missing or damaged, an extra is missing, or the system refuses.
    """
    origin = folder.read_origin()
    evaluations, runs = read_table(folder, runs=False), read_table(folder, runs=True)
    methods = find_methods(evaluations, runs)
    figures = _Figures(out, folder.figures_path.name)
    rows = runs.to_dict("records")
    text = _template("report.md.j2").render(
        title=words.plain(origin["title"]),
        description=origin["description"],
        state=_state(rows),
        tasks=[_task(task, group, figures) for task, group in methods.items()],
        overall=[
            [
                words.plain(one.label),
                one.seeds,
                words.span(one.robot_minutes),
                words.estimate(one.iqm),
                words.estimate(one.mean),
            ]
            for one in over_tasks(methods)
        ],
        trials=_trials(folder),
        repetitions=f"{REPETITIONS:,}",
        scipy=importlib.metadata.version("scipy"),
        facts=_facts(origin, rows),
        commands=list(dict.fromkeys(shlex.join(p["command"]) for p in origin["processes"])),
        runs=list(map(_run, rows)),
        made=made,
    )
    markdown, html = out / "report.md", out / "report.html"
    page = _template("report.html.j2").render(
        title=origin["title"], body=markupsafe.Markup(_as_html(text, figures))
    )
    write_atomically(markdown, lambda file: file.write(text.encode()))
    write_atomically(html, lambda file: file.write(page.encode()))
    return markdown, html


def _template(name: str) -> jinja2.Template:
    source = importlib.resources.files(__package__).joinpath("templates", name).read_text()
    environment = jinja2.Environment(
        autoescape=".html." in name,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.from_string(source)


class _Figures:
    """Pictures of a report.

    Args:
        out: Folder of the report.
        name: Folder within it where they go.

    Attributes:
        paths: Those that were drawn, by what the report calls them.
    """

    def __init__(self, out: Path, name: str) -> None:
        self.paths: dict[str, Path] = {}
        self._folder = out / name
        self._folder.mkdir(parents=True, exist_ok=True)

    def draw(self, methods: Sequence[Method], task: str, title: str) -> dict[str, str]:
        """Draw those of a task, and return what the report calls them."""
        found = {}
        for name, draw in (("success", draw_success), ("minutes", draw_minutes)):
            path = self._folder / f"{task}-{name}.png"
            draw(methods, path, title)
            found[f"{name}_figure"] = called = f"{self._folder.name}/{path.name}"
            self.paths[called] = path
        return found


def _as_html(markdown: str, figures: _Figures) -> str:
    """Render Markdown with the report's pictures within.

    What looks like HTML in it is text, and so is any other picture: it would be a file of whoever
    makes the report, or a request to somebody else.
    """
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse(markdown)
    for token in tokens:
        for inner in token.children or ():
            if inner.type == "image":
                path = figures.paths.get(str(inner.attrs["src"]))
                if path is None:
                    inner.type, inner.tag = "text", ""
                else:
                    data = base64.b64encode(read_file(path, "figure")).decode()
                    inner.attrs["src"] = f"data:image/png;base64,{data}"
    page = str(reader.renderer.render(tokens, reader.options, {}))
    return page.replace("<table>", '<div class="table"><table>').replace(
        "</table>", "</table></div>"
    )


def _task(task: str, methods: Sequence[Method], figures: _Figures) -> dict[str, Any]:
    title = task.replace("_", " ").capitalize()
    found: dict[str, Any] = {
        "title": title,
        "rows": [_method(method, methods) for method in methods if method.runs],
        "missing": [words.plain(cell) for method in methods for cell in method.missing],
        "baselines": _baselines(methods),
    }
    return found | (figures.draw(methods, task, title) if found["rows"] else {})


def _baselines(methods: Sequence[Method]) -> list[str]:
    """What the baseline of the ratios is."""
    labels = [
        words.plain(baseline.label)
        for method in methods
        if (baseline := baseline_of(method, methods)) is not None and baseline is not method
    ]
    return list(dict.fromkeys(labels))


def _method(method: Method, others: Sequence[Method]) -> list[str]:
    count = len(method.runs)
    of_all = f"{method.finished} of {count + len(method.missing)} finished"
    return [
        words.plain(method.label),
        str(count) if method.whole else of_all,
        *(words.minutes_to(method.minutes_to(rate)) for rate in RATES),
        words.ratio(ratio_to_baseline(method, others, RATES[-1])),
        words.estimate(method.last("iqm")),
        words.estimate(method.last("mean")) if count >= LEAST_TRIMMED else "",
        words.percents(method.last_rates) if count > 1 else "",
        _final(method),
        words.span(method.robot_minutes) + _stop(method),
        _evaluations(method),
        words.duration(method.wall_seconds),
    ]


def _stop(method: Method) -> str:
    rates = dict.fromkeys(run.until_success for run in method.runs)
    told = [words.percent(rate) for rate in rates if rate is not None]
    return f", or at {' or '.join(told)} %" if told else ""


def _evaluations(method: Method) -> str:
    """How often it was evaluated, and by how many episodes."""
    spacings = [run.spacing_minutes for run in method.runs]
    episodes = dict.fromkeys(str(run.episodes) for run in method.runs)
    return f"{words.span((min(spacings), max(spacings)))} min, {' or '.join(episodes)} episodes"


def _final(method: Method) -> str:
    """Success of the final policies, in the order of the seeds."""
    finals = [run.final for run in method.runs]
    if not any(finals):
        return words.UNKNOWN
    return ", ".join(
        words.UNKNOWN if final is None else "{} of {}".format(*final) for final in finals
    )


def _run(row: Mapping[Any, Any]) -> list[str]:
    if row["state"] == "not begun":
        return [words.plain(row["cell"]), "not begun", "", "", "", ""]
    dirty = row["dirty"] is True
    commit = row["commit"][:10] + (", changed" if dirty else "")
    return [
        words.plain(row["cell"]),
        row["state"],
        words.minutes(row["robot_minutes"]),
        words.duration(row["wall_seconds"]),
        commit,
        words.as_code(row["command"]),
    ]


def _state(rows: Sequence[Mapping[Any, Any]]) -> str:
    finished = sum(row["state"] == "finished" for row in rows)
    if finished == len(rows):
        return f"All {len(rows)} runs have finished."
    return (
        f"**{finished} of {len(rows)} runs have finished;** the others are in here as far as they "
        "have come."
    )


def _facts(origin: Mapping[str, Any], rows: Sequence[Mapping[Any, Any]]) -> list[str]:
    """Manifest, versions, commits and machines."""
    begun = [row for row in rows if row["state"] != "not begun"]

    def each(*names: str) -> str:
        told = dict.fromkeys(", ".join(_fact(row, name) for name in names) for row in begun)
        return "; ".join(told) or words.UNKNOWN

    def _fact(row: Mapping[Any, Any], name: str) -> str:
        return str(row[name])[:_WIDTH_OF_A_CPU]

    versions = "; ".join(
        dict.fromkeys(
            ", ".join(f"{name} {row[name]}" for name in ("python", "torch", "mujoco", "numpy"))
            for row in begun
        )
    )
    return [
        f"Manifest: {origin['manifest']}",
        f"Commit: {each('commit')}"
        + (", with changes" if any(row["dirty"] is True for row in begun) else ""),
        f"Versions: {versions or words.UNKNOWN}",
        f"Machine: {each('cpu', 'cores')} cores, {each('system')}; one core a run",
        "Robot: " + "; ".join(dict.fromkeys(row["robot"] for row in rows)),
    ]


def _trials(folder: ExperimentFolder) -> list[list[str]]:
    """Rows of the table of trials, its head first."""
    if not folder.trials_path.exists():
        return []
    head, *rows = csv.reader(read_file(folder.trials_path, "table of trials").decode().splitlines())
    sign = -1.0 if head[2] == "success-at-budget" else 1.0
    rows.sort(key=lambda row: sign * float(row[2]) if row[2] else math.inf)
    return [[words.plain(_short(text)) for text in row] for row in (head, *rows)]


def _short(text: str) -> str:
    try:
        return f"{float(text):.4g}"
    except ValueError:
        return text
