"""Joint angles as biomechanics names them: ISB recommendations, coordinates of OpenSim models."""
