"""Error against time and step: work-precision, stability, and the stored references."""
