"""Recorded skeletons: which joints are ours, one shape for all clips, the solve."""
