"""Slips and good recordings, damaged files, faults in the code: how far the library is trusted."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from benchmarks.slips.verdict import Verdict
from benchmarks.tables.values import NONE, markdown, number, result, source
from recon.benchmark.table import interval


def slips() -> str:
    """Every slip on test windows: what became of it."""
    found = result("slips")["slips"]
    clips = {key: [Verdict.of(clip) for clip in row["clips"]] for key, row in found.items()}
    rows = [
        [key, f"{row['size']:g} {row['unit']}".strip(), *_errors(key, clips[key]),
         *_counts(clips[key])]
        for key, row in found.items()
    ]  # fmt: skip
    every = [clip for row in clips.values() for clip in row]
    rows.append(["all", NONE, NONE, NONE, *_counts(every)])
    headings = ["sensor: slip", "size", "clean", "examined", "as good", "as good or warned",
                "named"]  # fmt: skip
    return markdown(headings, rows) + _shares(every) + source("slips")


def false_alarms() -> str:
    """What was said about good windows and is not so."""
    good = result("slips")["good"]
    windows, alarms = Counter(map(_kind, good)), Counter[str]()
    codes: dict[str, Counter[str]] = {}
    for row in good:
        said = {alarm["code"] for alarm in row["alarms"]}
        alarms[_kind(row)] += bool(said)
        codes.setdefault(_kind(row), Counter()).update(said)
    rows = [
        [kind, str(windows[kind]), str(alarms[kind]),
         ", ".join(f"{n} {code}" for code, n in codes[kind].most_common()) or NONE]
        for kind in sorted(windows)
    ]  # fmt: skip
    share = f"{alarms.total()} ({100 * alarms.total() / len(good):.1f} %)"
    rows.append(["all", str(len(good)), share, NONE])
    return markdown(["windows", "fitted", "false alarms", "codes"], rows) + source("slips")


def damaged_files() -> str:
    """Ten thousand mutants through every reader."""
    found = result("fuzz_readers")
    rows = [
        [kind, str(counts.get("refused", 0)), str(counts.get("read", 0)),
         str(sum(n for name, n in counts.items() if name not in ("refused", "read")))]
        for kind, counts in found["rows"].items()
    ]  # fmt: skip
    slowest, largest = found["slowest"]["seconds"], found["largest"]["bytes"] / 2**20
    said = f"\n\nThe slowest took {slowest:.1f} CPU s, the largest {largest:.0f} MB."
    headings = ["kind of file", "refused", "read, values plausible", "faults"]
    return markdown(headings, rows) + said + source("fuzz_readers")


def uncertainty() -> str:
    """Errors beside the standard deviations that fits state."""
    rows = [
        [name, kind, number(row[kind]["within"], 1, 2), number(row[kind]["rms"], 100, 2),
         number(row[kind]["median_std"], 100, 2), number(row[kind]["rank_correlation"], 1, 2),
         number(row["cost"]["share_of_fit"], 100, 0)]
        for name, row in result("uncertainty")["rows"].items()
        for kind in ("seen", "hidden") if kind in row
    ]  # fmt: skip
    headings = ["data; prior", "joints", "within 1.645 std (0.9)", "error of an axis, cm",
                "median std, cm", "rank correlation", "% of the fit's time"]  # fmt: skip
    parts = [markdown(headings, rows), _grounds(), _contacts()]
    return "\n\n".join(part for part in parts if part) + source("uncertainty")


def _grounds() -> str:
    """Grounds that were found: errors of their height and normal beside what fits state."""
    factors = {"height": ("cm", 100), "normal, degrees": ("degrees", 1)}
    rows = [
        [name, f"{kind.split(',')[0]}, {unit}", number(row[kind]["within"], 1, 2),
         number(row[kind]["median_error"], factor, 1), number(row[kind]["rms"], factor, 1),
         number(row[kind]["median_std"], factor, 1)]
        for name, row in result("uncertainty")["rows"].items()
        for kind, (unit, factor) in factors.items() if kind in row
    ]  # fmt: skip
    headings = ["data; prior", "ground", "within 1.645 std (0.9)", "median error", "RMS error",
                "median std"]  # fmt: skip
    return markdown(headings, rows) if rows else ""


def _contacts() -> str:
    """How often feet touch where the prior says so."""
    found = {
        name: row["contacts"]
        for name, row in result("uncertainty")["rows"].items()
        if "contacts" in row
    }
    if not found:
        return ""
    said = [key for key in next(iter(found.values())) if key.startswith("said ")]
    rows = [
        [name, *(number(row[key], 100, 0) if key in row else NONE for key in said)]
        for name, row in found.items()
    ]
    headings = ["feet that touch, %, where the probability is", *(k[5:] for k in said)]
    return markdown(headings, rows)


def refine() -> str:
    """Estimates of a network, refined, beside plain fits to them."""
    rows = [
        [name, number(row["joints"], 100, 1), number(row["about_pelvis"], 100, 2),
         number(row["acceleration"], 1, 1), number(row["slip"], 100, 1), number(row["peak"], 1, 2),
         number(row["peak_error"], 100, 0), number(row["seconds"], 1, 1)]
        for name, row in result("refine")["table"].items()
    ]  # fmt: skip
    headings = ["", "joints, cm", "about the pelvis, cm", "acceleration, m/s²", "slip, cm/s",
                "peak speed / true", "off by, %", "CPU s"]  # fmt: skip
    return markdown(headings, rows) + source("refine")


def mutants() -> str:
    """Small faults in the code that its tests notice."""
    found = result("mutants")
    rows = [
        [f"`{row['module']}`", str(row["mutants"]), str(row["killed"])] for row in found["modules"]
    ]
    rows.append(
        ["all", str(found["mutants"]), f"{found['killed']} ({100 * found['share']:.0f} %)"]
    )
    return markdown(["module", "faults tried", "noticed"], rows) + source("mutants")


def _errors(key: str, clips: Sequence[Verdict]) -> list[str]:
    """Mean errors of the clean and of the slipped clips: centimetres, or factors for rates."""
    factor, digits = (1, 2) if ": rate" in key else (100, 1)
    means = [
        sum(values) / len(clips)
        for values in ([clip.clean for clip in clips], [clip.error for clip in clips])
    ]
    return [number(value, factor, digits) for value in means]


def _counts(clips: Sequence[Verdict]) -> list[str]:
    judged = [clip for clip in clips if clip.judged]
    return [
        f"{sum(clip.as_good for clip in clips)}/{len(clips)}",
        f"{sum(clip.caught for clip in clips)}/{len(clips)}",
        f"{sum(clip.named for clip in judged)}/{len(judged)}",
    ]


def _shares(clips: Sequence[Verdict]) -> str:
    judged = [clip for clip in clips if clip.judged]
    caught = _share([clip.caught for clip in clips], clips)
    named = _share([clip.named for clip in judged], judged)
    return f"\n\nAs good or warned: {caught}. Cause named: {named}."


def _share(flags: Sequence[bool], clips: Sequence[Verdict]) -> str:
    """A share in percent with its 95 % interval over clips."""
    names = [clip.clip for clip in clips]
    found = interval([float(flag) for flag in flags], names, ["all"] * len(names))
    return f"{100 * found.mean:.1f} % [{100 * found.low:.1f}, {100 * found.high:.1f}]"


def _kind(row: dict[str, Any]) -> str:
    """Simulated windows by sensor, real ones by their collection."""
    name = row["window"]
    for sensor in ("joints3d", "markers3d", "cameras", "camera"):
        if f" {sensor}: " in name:
            return f"simulated {sensor}"
    return f"real {name.split('/')[0]}"
