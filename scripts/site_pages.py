"""Turns files outside of docs/ into pages of the site, and adapts links to them, for mkdocs.

The README is the front page, the cards of the weights and the examples have pages of their own.
Documents name each other by their places in the repository, so links work there and on the site.
"""

import re
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"(\]\()([^)#\s]+)((?:#[^)\s]*)?\))")
_CODE = re.compile(r"(^ *```.*?^ *```|`[^`\n]+`)", re.S | re.M)


def places() -> dict[str, str]:
    """Return the site's pages of files that are not in docs/, keyed by path of the file."""
    cards = {
        **{f"priors/weights/{p.name}": f"cards/{p.name}" for p in _sorted("priors/weights/*.md")},
    }
    examples = {f"examples/{p.name}": f"examples/{p.stem}.md" for p in _sorted("examples/*.py")}
    own = {
        "README.md": "index.md",
        "CHANGELOG.md": "changelog.md",
        "CONTRIBUTING.md": "contributing.md",
        "NOTICE": "notice.md",
        "LICENSE": "licence.md",
        "CITATION.cff": "citation.md",
        "recon/benchmark/splits.toml": "splits.md",
    }
    return {**own, **cards, **examples}


def _sorted(pattern: str) -> list[Path]:
    return sorted(ROOT.glob(pattern))


def markdown(path: str) -> str:
    """Return a file of the repository as Markdown; other formats become a block of code."""
    text = (ROOT / path).read_text(encoding="utf-8")
    if path.endswith(".md"):
        return text
    language = "python" if path.endswith(".py") else "text"
    return f"# {Path(path).name}\n\n```{language}\n{text.rstrip()}\n```\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of files outside of docs/."""
    for source, page in places().items():
        files.append(File.generated(config, page, content=markdown(source)))
    return files


def on_page_markdown(text: str, page: Page, **_: object) -> str:
    """Convert links between files of the repository to links between pages of the site."""
    sources = {target: source for source, target in places().items()}
    page_path = page.file.src_uri
    return relinked(text, sources.get(page_path, f"docs/{page_path}"), page_path)


def relinked(text: str, source: str, page: str) -> str:
    """Convert the links in a text of the file `source` to those of its page `page`."""
    parts = _CODE.split(text)
    return "".join(
        part if _CODE.fullmatch(part) else _LINK.sub(lambda m: _moved(m, source, page), part)
        for part in parts
    )


def _moved(match: re.Match[str], source: str, page: str) -> str:
    """Convert one link; those to the web and to files without a page stay as they are."""
    before, link, after = match.groups()
    if ":" in link:
        return match.group()
    target = normpath(join(dirname(source), link))
    to = places().get(target) or target.removeprefix("docs/")
    if to == target:
        return match.group()
    return f"{before}{relpath(to, dirname(page) or '.')}{after}"
