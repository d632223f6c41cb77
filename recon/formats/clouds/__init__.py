"""Point clouds, surface scans and depth images."""
