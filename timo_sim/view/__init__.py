"""From tracks to rerun: entities, panels, pictures, a live stream. No log, no ROS."""
