"""What checks made of the views of a clip."""

from dataclasses import dataclass

from recon.diagnosis.findings import Finding
from recon.diagnosis.views.images import Images


@dataclass(frozen=True)
class Outcome:
    """All views after what was sure was undone."""

    images: Images
    repairs: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()

    def then(self, other: "Outcome") -> "Outcome":
        """The findings of this outcome before those of another."""
        return Outcome(
            other.images, (*self.repairs, *other.repairs), (*self.warnings, *other.warnings)
        )
