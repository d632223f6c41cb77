"""Files of body models (SMPL, SMPL-H, SMPL-X), read without executing anything."""
