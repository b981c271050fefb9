"""Pictures and pages of doc/: the arm, the gallery, the control examples and the paper."""
