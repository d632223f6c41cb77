"""Makes the HTML of films that play beside a page's scene, synchronised with it."""

import base64
import html
import os
import tempfile
from importlib import resources
from pathlib import Path
from urllib.parse import quote

from recon.core.visible import visible
from recon.view.overlay import write_overlay
from recon.view.scene import Show

EMBEDDED_FRAMES = 3000
"""Most frames of a film that is embedded in the page: about 10 MB."""


def films_html(show: Show, page: Path, overlay: Path | None = None) -> str:
    """Return HTML of a scene's films, with the body over them; "" where there are none.

    Long films are not embedded: the page plays the files themselves, without the body, by their
    paths relative to the page.

    Args:
        show: the scene.
        page: file of the page.
        overlay: film that `write_overlay` drew of the scene; None draws it now.
    """
    if not any(view.film for view in show.cameras):
        return ""
    videos = (
        _embedded_films(show, overlay)
        if show.frames <= EMBEDDED_FRAMES
        else _linked_films(show, page)
    )
    assets = resources.files("recon") / "assets"
    style = (assets / "films.css").read_text(encoding="utf-8")
    script = (assets / "films.js").read_text(encoding="utf-8")
    return f'<style>{style}</style><div id="recon-films">{videos}</div><script>{script}</script>'


def _embedded_films(show: Show, overlay: Path | None) -> str:
    with tempfile.TemporaryDirectory() as folder:
        if overlay is None:
            write_overlay(overlay := Path(folder) / "films.mp4", show)
        data = base64.b64encode(overlay.read_bytes()).decode("ascii")
    # shifted by half a frame: at a frame's first instant browsers still show the previous one
    return _video_html(f"data:video/mp4;base64,{data}", 0.5 / show.fps, 1.0)


def _linked_films(show: Show, page: Path) -> str:
    parts: list[str] = []
    for view in show.cameras:
        if (on_clock := view.film) is None:
            continue
        film = on_clock.film
        place = os.path.relpath(film.path.resolve(), page.resolve().parent)
        offset = show.figures[0].motion.start_time - on_clock.start_time + 0.5 / film.frame_rate
        name = html.escape(visible(film.path.name))
        parts.append(_video_html(quote(place), offset, film.clock.speed))
        parts.append(
            f"<p>{html.escape(visible(view.name))}: {name} is too long to be part of this page. "
            "Keep it where it lies, as seen from here; a browser may not know its format.</p>"
        )
    return "".join(parts)


def _video_html(source: str, offset: float, speed: float) -> str:
    """Return HTML of a mute video, which shows second (t + offset) * speed at scene time t."""
    return (
        f'<video src="{html.escape(source)}" muted playsinline preload="auto" '
        f'data-offset="{offset:.6f}" data-speed="{speed:.6f}"></video>'
    )
