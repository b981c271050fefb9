"""Runs on disk: MCAP files that ros2 bag, rerun and other readers open."""
