"""The colours of all pictures."""

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

BLUE: Colour = (116, 160, 214)
CORAL: Colour = (232, 150, 122)
GREY: Colour = (182, 186, 192)
VISIBLE: Colour = (0, 128, 98)
"""Observed points, in space and in images."""
MISSING: Colour = (214, 40, 96)
"""Points that were not observed, where the estimate has them."""
REPROJECTED: Colour = (38, 42, 50)
"""Observed points where the estimate has them in an image."""
CONTACT: Colour = (248, 160, 24)
CERTAINTY: Colour = (160, 60, 205)
"""Spheres of one standard deviation around joints."""
CLOUD: Colour = (92, 98, 110)
CAMERA: Colour = (108, 88, 178)
GROUND: Colour = (188, 194, 203)
"""Lines of the grid on the ground."""
INK: Colour = (38, 42, 50)
FAINT: Colour = (112, 118, 128)
WHITE: Colour = (255, 255, 255)
