"""Gallery of the examples, from the files in ``examples``."""

import ast
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
PAGE = "start/gallery.md"
INTRODUCTION = """\
# Gallery

Every file of the folder `examples`, with the figure that it draws.
Run one with `python examples/NAME.py` or `tarc run examples/NAME.yaml`.
"""


def on_files(files: Files, config: Any) -> Files:
    """Add the page to the site."""
    files.append(File.generated(config, PAGE, content=page()))
    return files


def examples() -> list[Path]:
    """Return the files of the examples, programs first."""
    folder = ROOT / "examples"
    return [*sorted(folder.glob("*.py")), *sorted(folder.glob("*.yaml"))]


def page() -> str:
    """Return the whole page."""
    return "\n".join([INTRODUCTION, *map(entry, examples())])


def entry(path: Path) -> str:
    """Return the part of one example: title, text, figure, source."""
    title, text = description(path)
    figure = f"images/examples/{path.stem}.png"
    if not (ROOT / "docs" / figure).is_file():
        raise PluginError(
            f"{path.name} has no figure docs/{figure}; run make figures"
        )
    language = "python" if path.suffix == ".py" else "yaml"
    code = path.read_text(encoding="utf-8").strip()
    source = "\n".join(
        f"    {line}".rstrip()
        for line in f"```{language}\n{code}\n```".splitlines()
    )
    return (
        f"## {title}\n\n{text}\n\n![{title}](../{figure})\n\n"
        f'??? example "examples/{path.name}"\n\n{source}\n'
    )


def description(path: Path) -> tuple[str, str]:
    """Return the first line and the first paragraph of an example's text."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        text = ast.get_docstring(ast.parse(source)) or ""
    else:
        lines = source.splitlines()
        comments = [line for line in lines if line.startswith("#")]
        text = "\n".join(line.removeprefix("#").strip() for line in comments)
    title, _, body = text.partition("\n\n")
    if not title or not body:
        raise PluginError(
            f"{path.name} needs a title, an empty line and a paragraph"
        )
    return title.strip().rstrip("."), body.split("\n\n")[0]
