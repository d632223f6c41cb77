"""The documentation site: every link leads somewhere, and nothing is asked of the network."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

import observations
import priors
import recon
from scripts.site_pages import places, relinked

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site, built with links checked: a link or a name that leads nowhere fails the build."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(folder)]
    built = subprocess.run(
        command,
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


class _Loaded(HTMLParser):
    """What a browser fetches by itself when it opens a page."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in ("script", "img", "iframe"):
            self.addresses.append(given.get("src") or "")
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preconnect"):
            self.addresses.append(given.get("href") or "")


def test_pages_fetch_nothing_from_the_network(site):
    for path in site.rglob("*.html"):
        page = _Loaded()
        page.feed(path.read_text(encoding="utf-8"))
        outside = [one for one in page.addresses if one.startswith(("http", "//"))]
        assert outside == [], f"{path.relative_to(site)} loads {outside}"


def test_the_reference_has_every_public_name(site):
    pages = "".join(path.read_text(encoding="utf-8") for path in site.glob("api/*.html"))
    ids = set(re.findall(r'id="([\w.]+)"', pages))
    public = {f"recon.{name}" for name in recon._HOMES}
    others = set(observations._HOMES) - recon._HOMES.keys()
    public |= {f"observations.{n}" for n in others}
    public |= {f"priors.{n}" for n in priors._HOMES}
    assert public - ids == set()


def test_the_front_page_is_the_readme_with_its_picture(site):
    front = (site / "index.html").read_text(encoding="utf-8")
    assert 'src="demo.png"' in front
    assert (site / "demo.png").is_file()


def test_links_between_files_become_links_between_pages():
    assert places()["README.md"] == "index.md"
    text = "[a](docs/files.md#formats) [b](priors/weights/humor.md) `[c](docs/x.md)` [d](http://e)"
    assert relinked(text, "README.md", "index.md") == (
        "[a](files.md#formats) [b](cards/humor.md) `[c](docs/x.md)` [d](http://e)"
    )
    up = relinked("[a](../../docs/results.md)", "priors/weights/humor.md", "cards/humor.md")
    assert up == "[a](../results.md)"


def test_the_readme_is_short():
    words = (ROOT / "README.md").read_text(encoding="utf-8").split()
    assert len(words) <= 400, f"{len(words)} words; move what is too much to docs/"
