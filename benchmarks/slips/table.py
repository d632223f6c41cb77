"""Fits of slipped and of good recordings, judged, and how they are shown."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.slips.errors import claimed_samples, error
from benchmarks.slips.good import GoodWindow, GoodWindows, alarms
from benchmarks.slips.kinds import Slip
from benchmarks.slips.recordings import SENSORS, Recording, recording_of
from benchmarks.slips.verdict import Verdict, verdict_of
from recon.api.pipeline import fitted
from recon.benchmark.windows import TrueWindows
from recon.body.model import BodyModel
from recon.fitting.clip import fit_clip
from recon.fitting.fitted import ClipFit
from recon.fitting.methods import FitOptions


@dataclass(frozen=True)
class Judged:
    """One slip on all clips."""

    slip: Slip
    size: float
    verdicts: tuple[Verdict, ...]
    seconds: float
    """CPU time of one processor for one clip."""

    def report(self) -> dict[str, Any]:
        """The row as it stands in a result file."""
        clips = [asdict(verdict) for verdict in self.verdicts]
        return {
            "size": self.size, "unit": self.slip.unit, "seconds": self.seconds, "clips": clips
        }  # fmt: skip

    @classmethod
    def of(cls, slip: Slip, row: dict[str, Any]) -> "Judged":
        """The row of a result file."""
        verdicts = tuple(Verdict.of(clip) for clip in row["clips"])
        return cls(slip, row["size"], verdicts, row["seconds"])


def judged(
    windows: TrueWindows,
    clips: Sequence[int],
    slips: Sequence[Slip],
    sizes: dict[str, float],
    settings: FitOptions,
    body: BodyModel,
    *,
    unrepaired: bool,
) -> Iterator[Judged]:
    """Every slip on some of the windows, as it is done."""
    for sensor in SENSORS:
        own = [slip for slip in slips if slip.sensor == sensor]
        if len(own) == 0:
            continue
        recordings = [recording_of(windows, k, sensor, body) for k in clips]
        clean = [fit_clip(r.clean, settings, body) for r in recordings]
        for slip in own:
            began, size = time.process_time(), sizes[slip.key]
            rows = tuple(
                slipped(slip, size, recording, fit, settings, unrepaired)
                for recording, fit in zip(recordings, clean, strict=True)
            )
            yield Judged(slip, size, rows, (time.process_time() - began) / len(rows))


def slipped(
    slip: Slip,
    size: float,
    recording: Recording,
    clean: ClipFit,
    settings: FitOptions,
    unrepaired: bool,
) -> Verdict:
    """One slip on one clip."""
    seen, frames = slip.spoil(recording, size), recording.truth.frames
    found = fitted(seen, recording.names, settings, recording.body)
    claimed = claimed_samples(slip, found.observed, frames)

    def wrong(fit: ClipFit) -> float:
        return error(fit, recording, slip.measure, claimed)

    return verdict_of(
        slip, recording.name,
        clean=wrong(clean),
        unrepaired=wrong(fit_clip(seen, settings, recording.body)) if unrepaired else None,
        error=wrong(found.fit),
        repairs=found.repairs,
        warnings=found.warnings,
    )  # fmt: skip


HEADING = (
    f"{'slip':46s} {'size':>6s} {'clean':>6s} {'as is':>6s} {'found':>6s} {'good':>5s} "
    f"{'told':>5s} {'named':>6s} {'first':>6s}  codes; CPU s a clip"
)


def line(found: Judged) -> str:
    """One slip over its clips: mean errors in centimetres or factors, numbers of clips, codes."""
    slip, rows = found.slip, found.verdicts
    factor = 1.0 if slip.measure == "speed" else 100.0

    def average(values: list[float]) -> str:
        return f"{factor * sum(values) / len(values):6.1f}" if values else f"{'-':>6s}"

    with_cause = [r for r in rows if r.judged]
    said = Counter(f"{code} (repaired)" for r in rows for code in set(r.repairs))
    said += Counter(code for r in rows for code in set(r.warnings))
    return (
        f"{slip.key:46s} {found.size:6g} {average([r.clean for r in rows])} "
        f"{average([r.unrepaired for r in rows if r.unrepaired is not None])} "
        f"{average([r.error for r in rows])} "
        f"{sum(r.as_good for r in rows):2d}/{len(rows):2d} {sum(r.caught for r in rows):2d}/"
        f"{len(rows):2d} {sum(r.named for r in with_cause):3d}/{len(with_cause):2d} "
        f"{sum(r.first for r in with_cause):3d}/{len(with_cause):2d}  "
        + ", ".join(f"{count} {code}" for code, count in said.most_common())
        + f"; {found.seconds:.1f}"
    )


def totals(table: Sequence[Judged]) -> dict[str, int]:
    """Numbers of fits over all slips and clips."""
    rows = [verdict for found in table for verdict in found.verdicts]
    with_cause = [r for r in rows if r.judged]
    return {
        "fits": len(rows),
        "caught": sum(r.caught for r in rows),
        "with_cause": len(with_cause),
        "named": sum(r.named for r in with_cause),
        "named_first": sum(r.first for r in with_cause),
    }


def summary(table: Sequence[Judged]) -> str:
    """A summary of the table in a sentence."""
    found = totals(table)
    share = {key: _share(found[key], found["with_cause"]) for key in ("named", "named_first")}
    return (
        f"{found['caught']} of {found['fits']} caught ({_share(found['caught'], found['fits'])}); "
        f"of {found['with_cause']} the cause is named in {found['named']} ({share['named']}), "
        f"first in {found['named_first']} ({share['named_first']})"
    )


def quiet(
    good: GoodWindows,
    windows: Sequence[GoodWindow],
    settings: FitOptions,
    body: BodyModel,
) -> Iterator[dict[str, Any]]:
    """Fit good windows; print what is said about them and is not so."""
    for window in windows:
        seen, names = good.load(window)
        found = fitted(seen, names, settings, body)
        said = alarms(window, (*found.repairs, *found.warnings))
        for finding in said:
            print(f"{window.name}: {finding.code}: {finding.message}", flush=True)
        yield {"window": window.name, "alarms": [finding.report() for finding in said]}


def false_alarms(rows: Sequence[dict[str, Any]]) -> str:
    """How many good windows anything was said about."""
    false = sum(len(row["alarms"]) > 0 for row in rows)
    return f"{false} false alarms about {len(rows)} good windows ({_share(false, len(rows))})"


def _share(part: int, whole: int) -> str:
    return f"{100 * part / max(whole, 1):.1f} %"
