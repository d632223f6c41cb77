"""When scans and clouds were recorded, and the frames that this makes."""
