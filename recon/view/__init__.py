"""Pictures of motions: a page (`html`), images and films (`frames`), with cameras (`panels`)."""

from recon.view.show.scene import Figure as Figure
from recon.view.show.scene import Points as Points
from recon.view.show.scene import Show as Show
from recon.view.show.views import View as View
