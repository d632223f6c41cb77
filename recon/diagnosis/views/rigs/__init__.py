"""Clock and pose of cameras that do not fit the other views of a rig."""
