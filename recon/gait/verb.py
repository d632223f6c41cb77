"""`recon report`: the gait report of a trial."""

from pathlib import Path

from recon.cli.making import Verb, command_function
from recon.cli.places import Arguments, Place
from recon.formats.outputs import Output


def _page_and_table(out: Path, _: Arguments) -> tuple[Output, ...]:
    # imported only when needed, since it loads torch, which takes long
    from recon.gait.laboratory import outputs_of

    return outputs_of(out)


report = command_function(
    "report", Verb("recon.gait.report:report_file", (Place("out", _page_and_table),))
)
"""Write a laboratory report; see `recon.gait.report.report_file`."""
