"""Any mocap recording becomes a motion of our body: skeletons, markers, whole collections."""

from recon.ingest.conversion import Conversion as Conversion
from recon.ingest.single import convert as convert
from recon.ingest.subject import SubjectModel as SubjectModel
