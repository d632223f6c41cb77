"""Reads and validates a USD file by OpenUSD; runs in a Python with usd-core, without recon.

python in_usd.py FILE.usdc OUT.npz FRAMES
"""

import json
import sys

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel, UsdValidation, Vt


def main(path: str, out: str, frames: int) -> None:
    stage = Usd.Stage.Open(path)
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetPrimAtPath("/person")), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/person/skeleton")))
    mesh = stage.GetPrimAtPath("/person/body")
    skinning = cache.GetSkinningQuery(mesh)
    rest = UsdGeom.Mesh(mesh).GetPointsAttr().Get()
    joints, skin = [], []
    for frame in range(frames):
        joints.append(np.array(query.ComputeJointSkelTransforms(frame))[:, 3, :3])
        if frame % 10 == 0:
            moved = Vt.Vec3fArray(rest)
            skinning.ComputeSkinnedPoints(query.ComputeSkinningTransforms(frame), moved, frame)
            skin.append(np.array(moved))
    np.savez(out, joints=np.array(joints), skin=np.array(skin))
    names = [path.rpartition("/")[2] for path in query.GetJointOrder()]
    every = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(every).Validate(stage)
    said = {
        "version": ".".join(str(part) for part in Usd.GetVersion()),
        "names": names,
        "validators": len(every),
        "messages": [one.GetMessage() for one in found],
        "time_codes": stage.GetEndTimeCode() - stage.GetStartTimeCode() + 1,
    }
    sys.stdout.write(json.dumps(said) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
