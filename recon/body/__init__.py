"""The body: its model, joints, named points and parts, how feet stand, cycles of gait."""
