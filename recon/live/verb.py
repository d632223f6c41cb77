"""`recon stream`: estimates of the body while it is recorded, moment by moment."""

from functools import partial
from pathlib import Path

from tyro.conf import Positional

_LONGEST_LINE = 1 << 20
"""Characters of a line of stdin that are read together; a moment takes some thousand."""


def stream(
    observations: Positional[tuple[Path, ...]],
    prior: str = "pose",
    lag: int = 15,
    camera: Path | None = None,
    frame_rate: float | None = None,
    method: str | None = None,
    noise: float | None = None,
    shape: str | None = None,
    body: Path | None = None,
    vmc: str | None = None,
    live_link: str | None = None,
) -> None:
    """Read moments from stdin and write estimates to stdout while a person is recorded.

    The observations are templates: they say what the points are, their rate and their camera.
    Stdin has a JSON object per line and moment: {"points": [[x, y, z], null, ...], "time": 0.1},
    metres, null where a point was not seen; of 2D keypoints u, v and confidence; of several
    sensors a list of such lists. Without a time, a moment is one frame after the last.

    Stdout has a JSON object per line and estimate: time, trans, poses (axis-angle), joints, betas,
    observed, and findings where something was noticed. Lines that are no moments are
    skipped, and stderr says which.

    Args:
        observations: observation files of the sensors, of any length.
        prior: `pose`; `humor` is more accurate except for the fastest motions, takes about four
            times as long and needs 30 moments a second.
        method: `look` gives what a network proposes at first sight, not refined, in the place of a
            prior; or a network of your own, package.module:Class.
        lag: frames after which an estimate is final.
        camera: calibration of the cameras that 2D detections come from.
        frame_rate: frames per second, where files do not tell.
        noise: standard deviation of coordinates, metres or pixels; default: estimated.
        shape: held, such as height=1.80,weight=75; default: learned and then held.
        body: SMPL-family file; default: the bundled body.
        vmc: HOST:PORT, or PORT of this machine, that gets estimates by the VMC protocol (Unity,
            39539 as a rule); needs python-osc.
        live_link: HOST:PORT, or PORT of this machine, that gets them as Unreal's JSON Live Link.
    """
    import sys
    from contextlib import ExitStack
    from typing import Any

    from recon.cli import console
    from recon.cli.inputs import check_inputs
    from recon.fitting.settings import FitSettings
    from recon.reading.clip import load_clip

    check_inputs({"observations": observations, "camera": camera, "body": body})
    from recon.api.given import body_given
    from recon.api.preview import loaded_look
    from recon.live.lines import stream_lines
    from recon.live.links import Link, LiveLink, VmcLink
    from recon.live.stream import Stream

    with ExitStack() as stack:
        links: list[Link] = []
        if vmc is not None:
            links.append(stack.enter_context(VmcLink(vmc, console.print_error)))
        if live_link is not None:
            unreal = LiveLink(live_link, complain=console.print_error)
            links.append(stack.enter_context(unreal))
        model = body_given(body)
        clip = load_clip(observations, FitSettings(camera=camera, frame_rate=frame_rate), model)
        for note in (*clip.notes, "moments are in metres, with z up and the ground at z = 0"):
            console.print_note(note)
        likely = prior if method is None else loaded_look(method, "open", model)
        seen: Any = clip.observations[0] if len(clip.names) == 1 else list(clip.observations)
        live = Stream(likely, lag, template=seen, noise=noise, shape=shape, body=model)
        sys.stdin.reconfigure(errors="replace")  # pyright: ignore[reportAttributeAccessIssue]
        lines = iter(partial(sys.stdin.readline, _LONGEST_LINE), "")
        for line in stream_lines(lines, live, console.print_error, links):
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
