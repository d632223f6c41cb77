"""True human motion from noisy, partial observations."""

from recon.cli.batch import batch
from recon.cli.complete import complete
from recon.cli.convert import convert
from recon.cli.demo import demo
from recon.cli.evaluate import evaluate
from recon.cli.export import export
from recon.cli.fit import fit
from recon.cli.info import info
from recon.cli.interpolate import interpolate
from recon.cli.predict import predict
from recon.cli.retarget import retarget
from recon.cli.sample import sample
from recon.cli.simulate import simulate
from recon.cli.train import train
from recon.cli.view import view

ALL = (
    demo,
    fit,
    complete,
    batch,
    convert,
    sample,
    predict,
    interpolate,
    retarget,
    simulate,
    evaluate,
    view,
    export,
    info,
    train,
)
"""The verbs, in the order of `recon --help`."""
