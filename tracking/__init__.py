"""From video to motion: dots, trajectories, head motion, FAPs."""
