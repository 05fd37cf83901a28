"""Report of an experiment: Markdown, and the same as one HTML file."""

from __future__ import annotations

import base64
import importlib.metadata
import importlib.resources
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import markupsafe
from markdown_it import MarkdownIt

from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.report import formatting, provenance
from iher_robot.experiments.report.figures import draw_minutes, draw_success
from iher_robot.experiments.report.findings import Method, find_methods, over_tasks
from iher_robot.experiments.report.sections import overall_row, task_section
from iher_robot.experiments.report.statistics import REPETITIONS
from iher_robot.experiments.report.tables import read_tables, trial_rows
from iher_robot.storage.files.atomic import read_file, write_atomically


def write_report(folder: ExperimentFolder, out: Path, made: str) -> tuple[Path, Path]:
    """Write report and figures from the tables.

    Args:
        folder: The experiment.
        out: Folder to write to.
        made: Time of writing, as text.

    Returns:
        The Markdown and the HTML file.

    Raises:
        UserError: A table is missing or damaged, an extra is missing, or a file cannot be
            written.
    """
    metadata = folder.read_metadata()
    evaluations, runs = read_tables(folder)
    methods = find_methods(evaluations, runs)
    figures = _Figures(out, folder.figures_path.name)
    rows = runs.to_dict("records")
    text = _template("report.md.j2").render(
        title=formatting.plain(metadata["title"]),
        description=metadata["description"],
        state=provenance.state(rows),
        tasks=[_task(task, group, figures) for task, group in methods.items()],
        overall=list(map(overall_row, over_tasks(methods))),
        trials=trial_rows(folder.trials_path),
        repetitions=f"{REPETITIONS:,}",
        scipy=importlib.metadata.version("scipy"),
        facts=provenance.facts(metadata, rows),
        commands=provenance.commands(metadata),
        runs=list(map(provenance.run_row, rows)),
        made=made,
    )
    markdown, html = out / "report.md", out / "report.html"
    page = _template("report.html.j2").render(
        title=metadata["title"], body=markupsafe.Markup(_as_html(text, figures))
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
    """Figures of a report.

    Args:
        out: Folder of the report.
        name: Subfolder of the figures.

    Attributes:
        paths: Files of the figures, by their link in the report.
    """

    def __init__(self, out: Path, name: str) -> None:
        self.paths: dict[str, Path] = {}
        self._folder = out / name
        self._folder.mkdir(parents=True, exist_ok=True)

    def draw(self, methods: Sequence[Method], task: str, title: str) -> dict[str, str]:
        """Draw the figures of a task and return their links."""
        found = {}
        for name, draw in (("success", draw_success), ("minutes", draw_minutes)):
            path = self._folder / f"{task}-{name}.png"
            draw(methods, path, title)
            found[f"{name}_figure"] = link = f"{self._folder.name}/{path.name}"
            self.paths[link] = path
        return found


def _as_html(markdown: str, figures: _Figures) -> str:
    """Render Markdown as HTML with the report's figures embedded.

    HTML in the Markdown stays text, and so do other images: they could name a private file of the
    user, or send a request to a server.
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
    section = task_section(task, methods)
    return section | (figures.draw(methods, task, section["title"]) if section["rows"] else {})
