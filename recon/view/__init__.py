"""Draws motions: as a page (`html`), and as images and films (`frames`)."""

from recon.view.scene import Figure as Figure
from recon.view.scene import Points as Points
from recon.view.scene import Show as Show
from recon.view.scene import View as View
