"""Times, memory and latencies: of a step, a run, a sweep and the node; each beside a peer."""
