"""facewright: turns a captured performance into an animated head."""

__version__ = "0.1.0"
