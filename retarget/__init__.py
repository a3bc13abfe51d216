"""From parameters to a moving head: feature-point deformation and export."""
