"""From pictures to geometry. Calibration, texturing and scans join with their own issues."""
