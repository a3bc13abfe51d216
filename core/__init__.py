"""The shared vocabulary: cameras, meshes, trajectories, clips, MPEG-4 tables, files."""
