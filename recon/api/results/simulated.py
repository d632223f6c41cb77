"""What simulated sensors saw of a motion, as `recon.simulate` returns it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from recon.api.results.printing import in_ten_lines
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.fitting.clip_files import Clip, clip_from
from recon.formats.clouds.scans import write_scans
from recon.formats.observations import ObservationFile, PointsFile, save_observation
from recon.formats.results.outputs import Kind, Output
from recon.formats.results.reports import versions
from recon.formats.results.writing import writing
from recon.method.protocols import Sensor
from recon.simulation.settings import SensorKind


@dataclass(frozen=True, repr=False)
class Simulated:
    """One observation of a known motion, or one per camera; walked through, it gives them."""

    kind: SensorKind
    """What the sensor gives."""
    files: Mapping[str, ObservationFile]
    """What files of them hold, by the name of the camera; without a name where there is none."""
    truth: Motion
    """The motion at the sensor's moments."""
    body: BodyModel
    """The body that moves."""

    @cached_property
    def clip(self) -> Clip:
        """The observations as a fit takes them, read as from files."""
        named = [(name or self.kind, file) for name, file in self.files.items()]
        return clip_from(named, self.body)

    @property
    def observations(self) -> tuple[Sensor, ...]:
        """The observations without their names; each has a leading axis of one clip."""
        return self.clip.observations

    def __iter__(self) -> Iterator[Sensor]:
        """One observation after the other."""
        return iter(self.observations)

    def __len__(self) -> int:
        """How many observations there are."""
        return len(self.files)

    def save(
        self,
        out: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> tuple[Path, ...]:
        """Write observation files; returns their paths.

        Args:
            out: file (.npz) of one observation; a folder for several cameras, which get
                OUT/CAMERA.npz. Of scans, .npz is one file, and all else a folder of PLY files
                with times.csv.
            overwrite: replace what is there and recon did not write.
            report: what to write beside them instead of the kind and the programs' versions.

        Raises:
            ReconError: when there are several cameras for one file.
            FileExistsError: when something is there that recon did not write, unless `overwrite`.
        """
        path, several = Path(out), len(self.files) > 1
        if several and path.suffix == ".npz":
            raise ReconError(
                f"{path} is one file, but there are {len(self.files)} cameras; give a folder"
            )
        scans = self.kind == "scans" and path.suffix != ".npz"
        output = Output(path, Kind.FOLDER if scans or several else Kind.FILE)
        said = {"kind": self.kind, "versions": versions()} if report is None else report
        with writing(output, report=said, overwrite=overwrite) as (staged,):
            for name, file in self.files.items():
                if scans:
                    assert isinstance(file, PointsFile)
                    write_scans(staged, file)
                else:
                    save_observation(staged / f"{name}.npz" if several else staged, file)
        return tuple(path / f"{name}.npz" for name in self.files) if several else (path,)

    def __repr__(self) -> str:
        """A summary of at most ten lines: what was simulated, how long, and by which cameras."""
        seconds = (self.truth.frames - 1) / self.truth.fps
        first = (
            f"Simulated {self.kind}: {self.truth.frames} moments, {seconds:.2f} s at "
            f"{self.truth.fps:g} per second"
        )
        return in_ten_lines(first, [f"camera {name}" for name in self.files if name], [])
