"""True human motion from noisy, partial observations.

`recon VERB --help` tells a verb's options, with examples; `recon --version` what is installed.
"""

from recon.batch.verb import batch
from recon.benchmark.verb import bench
from recon.cli.verbs.complete import complete
from recon.cli.verbs.convert import convert
from recon.cli.verbs.demo import demo
from recon.cli.verbs.fit import fit
from recon.cli.verbs.generation.interpolate import interpolate
from recon.cli.verbs.generation.predict import predict
from recon.cli.verbs.generation.sample import sample
from recon.cli.verbs.info import info
from recon.cli.verbs.judging.evaluate import evaluate
from recon.cli.verbs.refine import refine
from recon.cli.verbs.retarget import retarget
from recon.cli.verbs.simulate import simulate
from recon.cli.verbs.train import train
from recon.cli.verbs.view import view
from recon.export.verb import export
from recon.gait.verb import report
from recon.live.verb import stream

ALL = (
    demo,
    fit,
    complete,
    refine,
    batch,
    stream,
    convert,
    sample,
    predict,
    interpolate,
    retarget,
    simulate,
    evaluate,
    bench,
    report,
    view,
    export,
    info,
    train,
)
"""The verbs, in the order of `recon --help`."""
