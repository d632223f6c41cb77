"""Physics of bodies: mass, pressure, zero-moment point, energies and their metrics."""
