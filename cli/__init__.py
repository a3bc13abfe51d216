"""The `facewright` command."""
