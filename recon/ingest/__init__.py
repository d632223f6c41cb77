"""Conversion of mocap recordings (skeletons, markers) to motions of our body."""

from recon.ingest.conversion import Conversion as Conversion
from recon.ingest.single import convert as convert
from recon.ingest.subject import SubjectModel as SubjectModel
