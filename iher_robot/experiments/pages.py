"""The report of an experiment: Markdown, and the same as one HTML file."""

from __future__ import annotations

import base64
import csv
import importlib.metadata
import importlib.resources
import math
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
    find_methods,
    over_tasks,
    ratio_to_baseline,
)
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.numbers import REPETITIONS
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
    figures = out / folder.figures_path.name
    figures.mkdir(parents=True, exist_ok=True)
    rows = runs.to_dict("records")
    text = _template("report.md.j2").render(
        title=origin["title"],
        description=origin["description"],
        state=_state(rows),
        tasks=[_task(task, group, figures) for task, group in methods.items()],
        overall=[
            [
                words.in_table(one.label),
                one.seeds,
                words.estimate(one.iqm),
                words.estimate(one.mean),
            ]
            for one in over_tasks(methods)
        ],
        trials=_trials(folder),
        repetitions=f"{REPETITIONS:,}",
        scipy=importlib.metadata.version("scipy"),
        facts=_facts(origin, rows),
        commands=list(dict.fromkeys(" ".join(p["command"]) for p in origin["processes"])),
        runs=list(map(_run, rows)),
        made=made,
    )
    markdown, html = out / "report.md", out / "report.html"
    page = _template("report.html.j2").render(
        title=origin["title"], body=markupsafe.Markup(_as_html(text, out))
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


def _as_html(markdown: str, folder: Path) -> str:
    """Render Markdown with its pictures within; what looks like HTML in it is text."""
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse(markdown)
    for token in tokens:
        for inner in token.children or ():
            if inner.type == "image":
                picture = (folder / str(inner.attrs["src"])).read_bytes()
                data = base64.b64encode(picture).decode()
                inner.attrs["src"] = f"data:image/png;base64,{data}"
    page = str(reader.renderer.render(tokens, reader.options, {}))
    return page.replace("<table>", '<div class="table"><table>').replace(
        "</table>", "</table></div>"
    )


def _task(task: str, methods: Sequence[Method], figures: Path) -> dict[str, Any]:
    title = task.replace("_", " ").capitalize()
    found: dict[str, Any] = {
        "title": title,
        "rows": [_method(method, methods) for method in methods if method.runs],
        "missing": [cell for method in methods for cell in method.missing],
    }
    if found["rows"]:
        for name, draw in (("success", draw_success), ("minutes", draw_minutes)):
            path = figures / f"{task}-{name}.png"
            draw(methods, path, title)
            found[f"{name}_figure"] = f"{figures.name}/{path.name}"
    return found


def _method(method: Method, others: Sequence[Method]) -> list[str]:
    several = len(method.runs) > 1
    return [
        words.in_table(method.label),
        str(len(method.runs)),
        *(words.minutes_to(method.minutes_to(rate)) for rate in RATES),
        words.ratio(ratio_to_baseline(method, others, RATES[-1])),
        words.estimate(method.last("iqm")),
        words.estimate(method.last("mean")) if several else "",
        words.percents(method.last_rates) if several else "",
        _final(method),
        words.minutes(method.robot_minutes),
        words.duration(method.wall_seconds),
    ]


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
        return [row["cell"], "not begun", "", "", "", ""]
    dirty = row["dirty"] is True
    commit = row["commit"][:10] + (", changed" if dirty else "")
    return [
        words.in_table(row["cell"]),
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
    return [[words.in_table(_short(text)) for text in row] for row in (head, *rows)]


def _short(text: str) -> str:
    try:
        return f"{float(text):.4g}"
    except ValueError:
        return text
