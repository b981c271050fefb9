"""Faults and extremes that numerics, node, logs and files must survive."""
