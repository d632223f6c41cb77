"""The windows of the benchmarks and what is seen of them: those of `recon bench`."""

from recon.api.bench.sensors import noisy_joints as noisy_joints
from recon.api.bench.sensors import occluded_points as occluded_points
from recon.api.bench.sensors import with_gap as with_gap
from recon.api.bench.windows import FPS as FPS
from recon.api.bench.windows import FRAMES as FRAMES
from recon.api.bench.windows import TrueWindows as Windows  # noqa: F401
from recon.api.bench.windows import contacts_at as contacts_at
from recon.api.bench.windows import draw_girth as draw_girth
from recon.api.bench.windows import load_windows as load_windows
