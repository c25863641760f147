"""What the site (mkdocs.yml) takes from outside docs/: README, changelog and others become
pages, and each notebook one, with the outputs that it was kept with; the schemas come along."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import handcal.results
import handcal_sim.results

ROOT = Path(__file__).resolve().parents[2]
OF_THE_ROOT = {"README.md": "readme.md", "CHANGELOG.md": "changelog.md",
               "CONTRIBUTING.md": "contributing.md", "SECURITY.md": "security.md",
               "CODE_OF_CONDUCT.md": "code-of-conduct.md"}  # fmt: skip
TYPE = re.compile(r"(\[`([a-z-]+\.json)`\]\()\.\./\w+/\w+/results/\w+\.py\)")
LINK = re.compile(r"(\]\(|src=\"|href=\")([^)\"\s]+)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that have no file of their own in docs/."""
    for source, uri in OF_THE_ROOT.items():
        text = moved((ROOT / source).read_text(encoding="utf-8"))
        files.append(File.generated(config, uri, content=text))
    for path in sorted(Path(config.docs_dir).glob("*.ipynb")):
        for uri, content in notebook(path).items():
            files.append(File.generated(config, uri, content=content))
    for name, schema in (handcal.results.schemas() | handcal_sim.results.schemas()).items():
        content = json.dumps(schema, indent=2, ensure_ascii=False)
        files.append(File.generated(config, f"schemas/{name}.json", content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Links to what became a page lead to the page."""
    for source, uri in OF_THE_ROOT.items():
        markdown = re.sub(rf"\]\((?:\.\./)+{source}\b", f"]({'../' * depth(page)}{uri}", markdown)
    return TYPE.sub(r"\1schemas/\2)", markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Names that a docstring explains ("gyro: (n, 3) rad/s") stand out."""
    if not page.file.src_uri.startswith("api/"):
        return html
    return re.sub(r"(<p>|[.;]\s)([A-Za-z_]+): ", r"\1<strong>\2</strong>: ", html)


def depth(page: Page) -> int:
    return page.file.src_uri.count("/")


def moved(text: str) -> str:
    """A page of the root with its links as they are from docs/."""

    def link(found: re.Match[str]) -> str:
        before, target = found.groups()
        name, _, anchor = target.partition("#")
        uri = OF_THE_ROOT.get(name, name.removeprefix("docs/"))
        return before + uri + (f"#{anchor}" if anchor else "")

    return LINK.sub(link, text)


def notebook(path: Path) -> dict[str, str | bytes]:
    """A notebook as a page and its pictures: {uri: content}."""
    made: dict[str, str | bytes] = {}
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            picture = f"images/{path.stem}-{len(made)}.png"
            parts.append(shown(output, picture, made))
    title, _, rest = "\n\n".join(parts).partition("\n")
    kept = f"*This page is a notebook: [{path.name}]({path.name}).*"
    return {f"{path.stem}.md": f"{title}\n\n{kept}\n{rest}\n", **made}


def shown(output: dict[str, Any], picture: str, made: dict[str, str | bytes]) -> str:
    """One output as Markdown; a picture is added to what is made."""
    data = output.get("data", {})
    if "image/png" in data:
        made[picture] = base64.b64decode("".join(data["image/png"]))
        return f"![What the cell draws]({picture})"
    if "<pre" not in (html := "".join(data.get("text/html", ""))) and html:
        html = re.sub(r"(?s)<style.*?</style>| border=\"1\"| class=\"dataframe\"", "", html)
        lines = [line.strip() for line in html.splitlines() if line.strip()]
        return "\n".join(('<div class="out">', *lines, "</div>"))
    text = re.sub(r"\x1b\[[0-9;]*m", "", "".join(output.get("text") or data.get("text/plain", "")))
    return f"```{{ .text .out }}\n{text.rstrip()}\n```"
