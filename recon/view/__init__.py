"""Pictures of motions: an offline page (`html`), images and films without a GPU (`frames`)."""

from recon.view.scene import Figure as Figure
from recon.view.scene import Points as Points
from recon.view.scene import Show as Show
